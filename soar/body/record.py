"""One record for every body: Anny by default, SMPL-X where the user brings its file. Posing is :mod:`soar.body.lbs`."""

from __future__ import annotations

import dataclasses
import os

import numpy as np
import torch
from torch import Tensor

from soar.artifacts import read_npz, write_npz
from soar.body.openpose import COUNT
from soar.errors import ArtifactError, ModelFileError


@dataclasses.dataclass(frozen=True)
class BodyModel:
    """A skinned, shape-varying body in metres. V vertices, F triangles, J joints, B shape components, K keypoints.

    Attributes:
        name: what the record was built from.
        up, front, left: (3,) unit vectors of the rest body's own axes: head, face, left hand side.
        v_template: (V, 3) mean rest vertices.
        shapedirs: (V, 3, B) displacement of a vertex per unit beta; a beta of 1 is one standard deviation.
        J_template: (J, 3) mean rest joints.
        J_shapedirs: (J, 3, B) displacement of a joint per unit beta.
        weights: (V, J) skin weights; rows sum to one.
        parents: (J,) long; -1 for the root, which is joint 0; a parent precedes its children.
        faces: (F, 3) long, counter-clockwise seen from outside.
        joint_names: J names.
        interior: (F,) bool; faces nobody can see (mouth, eye sockets).
        keypoint_rows, keypoint_columns, keypoint_values: (E,) entries of the K x (V + J) keypoint regressor, whose
            columns are the vertices followed by the joints; the entries of a row sum to one.
        keypoint_valid: (K,) bool; False for a keypoint the body has no point for.
        canonical_pose: (J, 3) axis-angle of the canonical pose: arms level, elbows straight, legs spread.
        active: joints (A,) long, ascending, starting with the root, that a fit turns; the others stay at identity.
        stiffness: (J,) how reluctantly a joint leaves the rest pose, relative to a limb joint at 1; zero for the root.
        posedirs: (V, 3, 9 (J - 1)) pose blend shapes over R - I, or None.
        place: (V, 3) where a vertex lies on the default body, see :meth:`places`; None for the default body.
        hand_mean: (2, 45) axis-angle of the 15 joints of the mean left and right hand, or None. Poses of this project
            are relative to the rest body's flat hands; other people's may be relative to the mean.
        hand_components: (2, 45, 45) principal components, as rows, of the two hands' poses, or None.
    """

    name: str
    up: Tensor
    front: Tensor
    left: Tensor
    v_template: Tensor
    shapedirs: Tensor
    J_template: Tensor
    J_shapedirs: Tensor
    weights: Tensor
    parents: Tensor
    faces: Tensor
    joint_names: tuple[str, ...]
    interior: Tensor
    keypoint_rows: Tensor
    keypoint_columns: Tensor
    keypoint_values: Tensor
    keypoint_valid: Tensor
    canonical_pose: Tensor
    active: Tensor
    stiffness: Tensor
    posedirs: Tensor | None = None
    place: Tensor | None = None
    hand_mean: Tensor | None = None
    hand_components: Tensor | None = None

    def __post_init__(self) -> None:
        V, J, B, F, E = (
            len(self.v_template),
            len(self.J_template),
            self.shapedirs.shape[-1],
            len(self.faces),
            len(self.keypoint_rows),
        )
        shapes = {
            "up": (3,), "front": (3,), "left": (3,), "v_template": (V, 3), "shapedirs": (V, 3, B), "J_template": (J, 3),
            "J_shapedirs": (J, 3, B), "weights": (V, J), "parents": (J,), "faces": (F, 3), "interior": (F,),
            "keypoint_rows": (E,), "keypoint_columns": (E,), "keypoint_values": (E,), "keypoint_valid": (COUNT,),
            "canonical_pose": (J, 3), "stiffness": (J,), "posedirs": (V, 3, 9 * (J - 1)),
            "place": (V, 3), "hand_mean": (2, 45), "hand_components": (2, 45, 45),
        }  # fmt: skip
        for field, shape in shapes.items():
            value = getattr(self, field)
            if value is not None and tuple(value.shape) != shape:
                raise self._bad(f"{field} has the wrong shape", str(shape), str(tuple(value.shape)))
            if value is not None and not bool(torch.isfinite(value).all()):
                raise self._bad(f"{field} holds NaN or infinity", "finite numbers", "not finite")
        if len(self.joint_names) != J:
            raise self._bad("joint_names does not match the joints", f"{J} names", f"{len(self.joint_names)}")
        parents = self.parents.tolist()
        if parents[0] != -1 or any(not 0 <= p < j for j, p in enumerate(parents) if j):
            raise self._bad(
                "parents is not a tree in order", "-1 first, then parents before children", str(parents[:8])
            )
        active = self.active.tolist()
        if active[:1] != [0] or active != sorted(set(active)) or active[-1] >= J:
            raise self._bad(
                "active is not an ascending list of joints starting with the root", "0 first", str(active[:8])
            )
        if int(self.faces.min()) < 0 or int(self.faces.max()) >= V:
            raise self._bad(
                "faces name vertices that do not exist",
                f"0 to {V - 1}",
                f"{int(self.faces.min())} to {int(self.faces.max())}",
            )
        if (self.weights.sum(1) - 1).abs().max() > 1e-3:
            raise self._bad(
                "skin weights do not sum to one",
                "rows that sum to 1",
                f"off by {(self.weights.sum(1) - 1).abs().max():.3g}",
            )

    def _bad(self, what: str, expected: str, got: str) -> ModelFileError:
        return ModelFileError(
            f"body model {self.name}: {what}",
            expected=expected,
            got=got,
            cure="delete the file and fetch the models again",
        )

    def to(self, device: torch.device | str | None = None, dtype: torch.dtype | None = None) -> BodyModel:
        """The same body on another device or in another floating type."""
        changed = {}
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if isinstance(value, Tensor):
                changed[field.name] = value.to(device=device, dtype=dtype if value.is_floating_point() else None)
        return dataclasses.replace(self, **changed)

    def places(self) -> Tensor:
        """(V, 3) where each vertex lies on the default body's mean shape at rest: a name for it that bodies share.

        Metres from the origin of that body; x to its left, y backward, z up.
        """
        if self.place is not None:
            return self.place
        return self.v_template @ torch.stack([self.left, -self.front, self.up]).T

    def regressor(self) -> Tensor:
        """(K, V + J) sparse COO keypoint regressor."""
        index = torch.stack([self.keypoint_rows, self.keypoint_columns])
        size = (COUNT, len(self.v_template) + len(self.J_template))
        return torch.sparse_coo_tensor(index, self.keypoint_values, size, check_invariants=True).coalesce()

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the record as ``.npz``."""
        arrays: dict[str, np.ndarray] = {}
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if value is not None:
                arrays[field.name] = value.cpu().numpy() if isinstance(value, Tensor) else np.asarray(value)
        # Pose blend shapes hardly shrink, and every stage that reads the record would wait for them.
        write_npz(path, arrays, compress=self.posedirs is None)

    @staticmethod
    def load(path: str | os.PathLike[str]) -> BodyModel:
        """Read a record written by :meth:`save`.

        Raises:
            ModelFileError: the file is missing, truncated, lacks a field, or a field has another shape.
        """
        try:
            arrays = read_npz(path)
        except ArtifactError as error:
            raise ModelFileError(
                f"body model {path} cannot be read", got=str(error), cure="fetch the models again"
            ) from error
        fields = {f.name: f.default is dataclasses.MISSING for f in dataclasses.fields(BodyModel)}
        missing = [name for name, needed in fields.items() if needed and name not in arrays]
        if missing or set(arrays) - set(fields):
            raise ModelFileError(
                f"body model {path} is not of this layout",
                expected=", ".join(fields),
                got=f"missing {missing}, unknown {sorted(set(arrays) - set(fields))}",
                cure="delete the file and fetch the models again",
            )
        values = {k: torch.from_numpy(v) for k, v in arrays.items() if k not in ("name", "joint_names")}
        return BodyModel(name=str(arrays["name"]), joint_names=tuple(str(n) for n in arrays["joint_names"]), **values)
