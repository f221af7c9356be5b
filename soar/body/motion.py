"""The moving body of one clip, as files hold it."""

from __future__ import annotations

import dataclasses
import os

import torch
from torch import Tensor

from soar.artifacts import read_npz, write_npz
from soar.body.openpose import COUNT
from soar.errors import ArtifactError
from soar.geometry.rotations import axis_angle_to_matrix


@dataclasses.dataclass(frozen=True)
class BodyMotion:
    """One shape and T poses in the world.

    Attributes:
        betas: (B,) shape, in standard deviations.
        pose: (T, J, 3) axis-angle of every joint relative to its parent, in world-aligned rest axes, radians; joint 0
            turns the whole body about its own rest position.
        translation: (T, 3) metres, added last.
        keypoint_offsets: (137, 3) displacement of each keypoint's definition in rest space, metres; zeros if unused.
    """

    betas: Tensor
    pose: Tensor
    translation: Tensor
    keypoint_offsets: Tensor

    def __post_init__(self) -> None:
        T, J = self.pose.shape[:2] if self.pose.ndim == 3 else (0, 0)
        expected = {
            "betas": (len(self.betas),),
            "pose": (T, J, 3),
            "translation": (T, 3),
            "keypoint_offsets": (COUNT, 3),
        }
        for name, shape in expected.items():
            value = getattr(self, name)
            if tuple(value.shape) != shape or not bool(torch.isfinite(value).all()):
                raise ArtifactError(
                    f"body motion: {name} is malformed", expected=f"finite {shape}", got=str(tuple(value.shape))
                )

    @property
    def rotations(self) -> Tensor:
        """(T, J, 3, 3) local rotation matrices."""
        return axis_angle_to_matrix(self.pose)

    def __len__(self) -> int:
        return len(self.pose)

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write ``body.npz``."""
        write_npz(path, {f.name: getattr(self, f.name).detach().cpu().numpy() for f in dataclasses.fields(self)})

    @staticmethod
    def read(path: str | os.PathLike[str]) -> BodyMotion:
        """Read ``body.npz``; raises :class:`~soar.errors.ArtifactError` if it is missing or malformed."""
        names = [f.name for f in dataclasses.fields(BodyMotion)]
        return BodyMotion(**{k: torch.from_numpy(v) for k, v in read_npz(path, names).items()})
