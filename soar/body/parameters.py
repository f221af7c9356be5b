"""Body parameters that others estimated: one form for every archive, and its way to our camera, world and body record.

Everything is SMPL-X's: axis-angle in radians, metres, rest axes x left, y up, z front. An archive's own conventions are
undone by its reader (:mod:`soar.importers`), but for two, which need the body model: where the translation is measured
from (:attr:`SmplxParameters.lever`), and hands that are written against the mean hand or as PCA coefficients
(:class:`HandSpace`).
"""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from soar.body.initial import Poses
from soar.body.lbs import rest_joints
from soar.body.motion import BodyMotion
from soar.body.openpose import COUNT
from soar.body.record import BodyModel
from soar.body.smplx_file import JOINTS
from soar.errors import ConfigError, InputError
from soar.geometry.cameras import Camera
from soar.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle

BODY, FACE, LEFT_HAND, RIGHT_HAND = slice(1, 22), slice(22, 25), slice(25, 40), slice(40, 55)
"""Joints of SMPL-X after the root: the body's, jaw and two eyes, each hand's."""

SMPL_PELVIS = (-0.00179506, -0.22333382, 0.02821918)
"""Where the pelvis of SMPL's neutral mean body rests, metres; other betas move it by at most a few centimetres."""


@dataclasses.dataclass(frozen=True)
class SmplxParameters:
    """One person in T frames, as an archive has them.

    Attributes:
        frames: (T,) increasing numbers of the frames, as the archive counts them.
        global_orient: (T, 3) rotation of the root.
        body_pose: (T, 21, 3) rotations of the joints 1 to 21.
        translation: (T, 3) metres; what it moves is said by ``lever``.
        lever: (T, 3, 3) the matrix L with which the pelvis is at ``L j + translation``, j being where it rests: the
            identity for SMPL's own convention (translation added last), the root's rotation where the body turns about
            its origin, zero where the translation is the pelvis itself.
        frame: whether ``camera`` or ``world`` axes are meant; a camera is an OpenCV one (x right, y down, z forward).
        betas: (T, B) shape; None where it was of another body than SMPL-X.
        left_hand, right_hand: (T, 15, 3) rotations from the flat hand, or None.
        face: (T, 3, 3) rotations of jaw, left eye and right eye, or None.
        K: (T, 3, 3) intrinsics in pixels of that camera, which may be another in each frame; None in world axes.
        size: width and height of the images that K is for, pixels; None in world axes.
        rest_pelvis: (3,) where the pelvis rests in the archive's body, metres; None for SMPL-X, whose shape tells.

    Raises:
        InputError: a shape or number that cannot be.
    """

    frames: np.ndarray
    global_orient: np.ndarray
    body_pose: np.ndarray
    translation: np.ndarray
    lever: np.ndarray
    frame: Literal["camera", "world"]
    betas: np.ndarray | None = None
    left_hand: np.ndarray | None = None
    right_hand: np.ndarray | None = None
    face: np.ndarray | None = None
    K: np.ndarray | None = None
    size: tuple[int, int] | None = None
    rest_pelvis: np.ndarray | None = None

    def __post_init__(self) -> None:
        T = len(self.frames)
        shapes = {
            "global_orient": (T, 3), "body_pose": (T, 21, 3), "translation": (T, 3), "lever": (T, 3, 3),
            "left_hand": (T, 15, 3), "right_hand": (T, 15, 3), "face": (T, 3, 3), "K": (T, 3, 3), "rest_pelvis": (3,),
        }  # fmt: skip
        if self.betas is not None:
            shapes["betas"] = (T, self.betas.shape[-1])
        for name, shape in shapes.items():
            value = getattr(self, name)
            if value is not None and (value.shape != shape or not np.isfinite(value).all()):
                raise InputError(
                    f"body parameters: {name} is malformed", expected=f"finite {shape}", got=str(value.shape)
                )
        if T == 0 or (np.diff(self.frames) <= 0).any():
            raise InputError("body parameters: the frames are not numbered upwards", got=str(self.frames[:20]))
        if (self.frame == "camera") != (self.K is not None and self.size is not None):
            raise InputError("body parameters: intrinsics and image size belong to camera axes, and to nothing else")
        if self.size is not None and min(self.size) < 1:
            raise InputError("body parameters: the images have no size", got=str(self.size))
        if self.K is not None and (self.K[:, [0, 1], [0, 1]] <= 0).any():
            raise InputError(
                "body parameters: a focal length is not positive", got=str(self.K[:, [0, 1], [0, 1]].min())
            )

    def __len__(self) -> int:
        return len(self.frames)

    @property
    def shape(self) -> np.ndarray | None:
        """(B,) mean betas of the clip, or None."""
        return None if self.betas is None else self.betas.mean(0)

    def pelvis(self, model: BodyModel) -> np.ndarray:
        """(T, 3) where the pelvis is in the archive's axes, metres."""
        rest = self.rest_pelvis
        if rest is None:
            rest = rest_joints(model, model_betas(model, self.shape))[0].double().numpy()
        return np.asarray(self.lever @ rest + self.translation)

    def rotations(self) -> np.ndarray:
        """(T, 55, 3, 3) local rotations; joints that the archive leaves out are at rest."""
        pose = np.zeros((len(self), len(JOINTS), 3))
        pose[:, 0], pose[:, BODY] = self.global_orient, self.body_pose
        for part, value in ((FACE, self.face), (LEFT_HAND, self.left_hand), (RIGHT_HAND, self.right_hand)):
            if value is not None:
                pose[:, part] = value
        return matrices(pose)

    def changed(self, turn: np.ndarray, shift: np.ndarray) -> SmplxParameters:
        """The same body after a rigid change of axes ``x' = turn x + shift``.

        Args:
            turn: (3, 3) or (T, 3, 3) rotation.
            shift: (3,) or (T, 3) metres.
        """
        return dataclasses.replace(
            self,
            global_orient=axis_angles(turn @ matrices(self.global_orient)),
            translation=(turn @ self.translation[..., None])[..., 0] + shift,
            lever=turn @ self.lever,
        )


@dataclasses.dataclass(frozen=True)
class HandSpace:
    """What the fingers of an archive are measured in; left before right.

    Attributes:
        mean: (2, 45) axis-angle of the mean hand.
        components: (2, 45, 45) its principal components, as rows.
    """

    mean: np.ndarray
    components: np.ndarray

    @staticmethod
    def of(model: BodyModel) -> HandSpace:
        """That of a body record.

        Raises:
            ConfigError: the record has none.
        """
        if model.hand_mean is None or model.hand_components is None:
            raise ConfigError(
                f"the body record {model.name} has no mean hand and no hand components",
                expected="one that was made of an SMPL-X file",
                cure="make the record again, or leave the hands out: body.hands=false",
            )
        return HandSpace(model.hand_mean.double().numpy().reshape(2, 45), model.hand_components.double().numpy())

    def flat(
        self, left: np.ndarray, right: np.ndarray, *, coefficients: bool, from_mean: bool
    ) -> tuple[np.ndarray, np.ndarray]:
        """Both hands (T, 15, 3) as rotations from the flat hand.

        Args:
            left, right: (T, 45) axis-angle; or (T, n) ``coefficients`` of the first n components.
            coefficients: which of the two.
            from_mean: whether they are to be added to the mean hand.
        """
        flat = []
        for pose, mean, components in zip((left, right), self.mean, self.components, strict=True):
            full = pose @ components[: pose.shape[1]] if coefficients else pose
            flat.append((full + mean * from_mean).reshape(-1, 15, 3))
        return flat[0], flat[1]


def matrices(pose: np.ndarray) -> np.ndarray:
    """Axis-angle (..., 3) to matrices (..., 3, 3)."""
    return axis_angle_to_matrix(torch.from_numpy(np.asarray(pose, np.float64))).numpy()


def axis_angles(rotations: np.ndarray) -> np.ndarray:
    """Matrices (..., 3, 3) to axis-angle (..., 3)."""
    return matrix_to_axis_angle(torch.from_numpy(np.asarray(rotations, np.float64))).numpy()


def seen_by(parameters: SmplxParameters, pelvis: np.ndarray, camera: Camera) -> SmplxParameters:
    """What is in front of an archive's cameras, in front of one of ours at the same place that sees the same picture.

    Regressors assume cameras: SMPLer-X one of 5000 pixels focal length for every crop, with the body tens of metres
    away. In our camera, of focal length f*, the pelvis keeps its pixel and gets the depth ``z* = z f* / f``, which
    leaves the person as large in the picture. About its own long axis the body turns as the ray through its pelvis
    does, so that the camera goes on seeing the same side of it; without that, a body at the border of a wide picture
    would seem turned. It does not lean with the ray: what is as far away as the pelvis keeps its form. Where the two
    cameras are the same nothing changes; otherwise the picture is kept up to what perspective differs in the body's
    depth.

    Args:
        parameters: in camera axes.
        pelvis: (T, 3) where the pelvis is.
        camera: ours; its pose in the world does not matter.

    Raises:
        InputError: the body is behind the archive's camera, or its pictures have another shape than ours.
    """
    assert parameters.K is not None
    if (pelvis[:, 2] <= 0).any():
        raise InputError(
            "body parameters: the person is behind the camera",
            expected="positive depth in OpenCV axes (x right, y down, z forward)",
            got=f"{np.count_nonzero(pelvis[:, 2] <= 0)} of {len(pelvis)} frames with depth {pelvis[:, 2].min():.3g} m",
            cure="check that body.format names the tool that wrote the files",
        )
    K = _rescaled(parameters, camera)
    pixel = _project(K, pelvis)
    focal, ours = np.sqrt(K[:, 0, 0] * K[:, 1, 1]), np.sqrt(camera.K[0, 0] * camera.K[1, 1])
    rays = np.concatenate([pixel, np.ones((len(pixel), 1))], 1) @ np.linalg.inv(camera.K).T
    orient = matrices(parameters.global_orient)
    placed = rays * (pelvis[:, 2] * ours / focal)[:, None]
    return dataclasses.replace(
        parameters,
        global_orient=axis_angles(matrices(_turns(pelvis, placed, orient[..., 1])) @ orient),
        translation=placed,
        lever=np.zeros_like(parameters.lever),
        K=np.tile(camera.K, (len(pixel), 1, 1)),
        size=(camera.width, camera.height),
    )


def in_world(parameters: SmplxParameters, model: BodyModel, camera: Camera) -> SmplxParameters:
    """Parameters in the world's axes, whose translation is the pelvis.

    Args:
        parameters: in world axes, or in those of a camera.
        model: the body.
        camera: ours that theirs are taken for, see :func:`seen_by`.

    Raises:
        InputError: see :func:`seen_by`.
    """
    pelvis = parameters.pelvis(model)
    if parameters.frame == "world":
        return dataclasses.replace(parameters, translation=pelvis, lever=np.zeros_like(parameters.lever))
    seen = dataclasses.replace(seen_by(parameters, pelvis, camera), frame="world", K=None, size=None)
    return seen.changed(camera.R.T, -camera.R.T @ camera.t)


def model_betas(model: BodyModel, shape: np.ndarray | None) -> Tensor:
    """(B,) betas of the record: an archive's first ones, and zero for those that it lacks."""
    betas = model.v_template.new_zeros(model.shapedirs.shape[-1])
    if shape is not None:
        common = min(len(betas), len(shape))
        betas[:common] = torch.from_numpy(shape[:common]).to(betas)
    return betas


def motion_of(parameters: SmplxParameters, model: BodyModel) -> BodyMotion:
    """The motion of an SMPL-X record that shows the parameters as they are, float32.

    Args:
        parameters: in world axes.
        model: the body.
    """
    betas = model_betas(model, parameters.shape)
    translation = torch.from_numpy(parameters.pelvis(model)) - rest_joints(model, betas)[0].double()
    pose = torch.from_numpy(axis_angles(parameters.rotations()))
    return BodyMotion(betas.float(), pose.float(), translation.float(), torch.zeros(COUNT, 3))


def poses_of(parameters: SmplxParameters, model: BodyModel) -> Poses:
    """The parameters as the start of a fit, which holds jaw and eyes at rest.

    Args:
        parameters: in world axes.
        model: the body.
    """
    motion, like = motion_of(parameters, model), model.v_template
    rotations = torch.from_numpy(parameters.rotations()).to(like)[:, model.active]
    offsets = motion.keypoint_offsets.to(like)
    return Poses(motion.betas.to(like), rotations, motion.translation.to(like), offsets)


def with_face(motion: BodyMotion, parameters: SmplxParameters) -> BodyMotion:
    """A fitted motion with the jaw and eyes of the parameters it started from."""
    if parameters.face is None:
        return motion
    pose = motion.pose.clone()
    pose[:, FACE] = torch.from_numpy(parameters.face).to(pose)
    return dataclasses.replace(motion, pose=pose)


def _rescaled(parameters: SmplxParameters, camera: Camera) -> np.ndarray:
    """(T, 3, 3) the archive's intrinsics for images of our camera's size."""
    assert parameters.K is not None
    assert parameters.size is not None
    across, down = camera.width / parameters.size[0], camera.height / parameters.size[1]
    if abs(across / down - 1) > 0.01:
        raise InputError(
            "body parameters: they are for images of another shape",
            expected=f"the shape of the frames of {camera.name}, {camera.width} x {camera.height}",
            got=f"{parameters.size[0]} x {parameters.size[1]}",
            cure="use parameters of the same footage, neither cropped nor turned; or set body.image_size",
        )
    return np.diag([across, down, 1.0]) @ parameters.K


def _project(K: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Pixels (T, 2) of points (T, 3) in the axes of cameras (T, 3, 3)."""
    p = (K @ points[..., None])[..., 0]
    return p[:, :2] / p[:, 2:]


def _turns(a: np.ndarray, b: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """(T, 3) axis-angle of what part of the shortest turn from directions (T, 3) ``a`` to ``b`` is about ``axis``.

    Args:
        a, b: less than 90 degrees apart.
        axis: (T, 3) unit vectors.
    """
    a, b = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (a, b))
    cross = np.cross(a, b)
    sine = np.linalg.norm(cross, axis=1, keepdims=True)
    turn = cross * np.where(sine > 1e-9, np.arcsin(sine.clip(0, 1)) / sine.clip(1e-9), 1.0)
    return (turn * axis).sum(1, keepdims=True) * axis
