"""SMPL-X itself: vertices and the 144 joints of its official order from shape, expression and pose.

The pipeline works with the record that :mod:`soar.body.smplx_record` makes of a file; this is the model with everything
that a record leaves out (expression, hands as coefficients, the contour that follows the head), to which other people's
parameters refer. Units are metres and radians; T frames at a time; everything is differentiable but the choice of the
contour's row.
"""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from soar.body.lbs import chain, skin
from soar.body.smplx_file import JOINTS, PARENTS, SmplxFile
from soar.geometry.rotations import axis_angle_to_matrix

EXTRA_VERTICES = (
    9120, 9929, 9448, 616, 6, 5770, 5780, 8846, 8463, 8474, 8635, 5361, 4933, 5058, 5169, 5286, 8079, 7669, 7794, 7905,
    8022,
)  # fmt: skip
"""Vertices that are the joints 55 to 75: nose, right and left eye, right and left ear; big toe, small toe, heel, left
then right; finger tips from thumb to little finger, left then right."""

LANDMARKS = 76
"""The first of the joints that are face landmarks: 51 static ones, then the 17 of the contour."""

OPENPOSE = (
    55, 12, 17, 19, 21, 16, 18, 20, 0, 2, 5, 8, 1, 4, 7, *range(56, 66),
    20, 37, 38, 39, 66, 25, 26, 27, 67, 28, 29, 30, 68, 34, 35, 36, 69, 31, 32, 33, 70,
    21, 52, 53, 54, 71, 40, 41, 42, 72, 43, 44, 45, 73, 49, 50, 51, 74, 46, 47, 48, 75,
    *range(127, 144), *range(LANDMARKS, 127),
)  # fmt: skip
"""Of the 144 joints those that stand for OpenPose's keypoints 0 to 134, as SMPLify-X pairs them."""

_NECK = tuple(JOINTS.index(name) for name in ("pelvis", "spine1", "spine2", "spine3", "neck"))
_FAR = 39  # degrees of yaw beyond which the contour no longer follows


@dataclasses.dataclass(frozen=True)
class SmplX:
    """The model with B shape and E expression components.

    Attributes:
        v_template: (V, 3).
        shapedirs, exprdirs, posedirs: (V, 3, B), (V, 3, E) and (V, 3, 486).
        J_template, J_shapedirs, J_exprdirs: (55, 3), (55, 3, B) and (55, 3, E), the joints' share of the above.
        weights: (V, 55).
        parents: (55,) long.
        faces: (F, 3) long.
        hand_components: (2, 45, 45).
        hand_mean: (2, 45).
        landmark_faces, landmark_barycentrics: (51,) long and (51, 3).
        contour_faces, contour_barycentrics: (79, 17) long and (79, 17, 3).
    """

    v_template: Tensor
    shapedirs: Tensor
    exprdirs: Tensor
    posedirs: Tensor
    J_template: Tensor
    J_shapedirs: Tensor
    J_exprdirs: Tensor
    weights: Tensor
    parents: Tensor
    faces: Tensor
    hand_components: Tensor
    hand_mean: Tensor
    landmark_faces: Tensor
    landmark_barycentrics: Tensor
    contour_faces: Tensor
    contour_barycentrics: Tensor

    @staticmethod
    def of(file: SmplxFile, num_betas: int = 10, num_expression: int = 10, dtype: torch.dtype = torch.float32) -> SmplX:
        """The model of a file, or of the first components that it has."""
        same = (
            "v_template", "posedirs", "weights", "hand_components", "hand_mean", "landmark_barycentrics",
            "contour_barycentrics",
        )  # fmt: skip
        dirs = {"shapedirs": file.shapedirs[..., :num_betas], "exprdirs": file.exprdirs[..., :num_expression]}
        J = {f"J_{name}": np.einsum("jv,vxb->jxb", file.J_regressor, value) for name, value in dirs.items()}
        real = (
            {name: getattr(file, name) for name in same} | dirs | J | {"J_template": file.J_regressor @ file.v_template}
        )
        indices = {name: getattr(file, name) for name in ("faces", "landmark_faces", "contour_faces")}
        return SmplX(
            parents=torch.tensor(PARENTS),
            **{name: torch.tensor(np.ascontiguousarray(value), dtype=dtype) for name, value in real.items()},
            **{name: torch.tensor(value) for name, value in indices.items()},
        )

    def full_pose(
        self,
        global_orient: Tensor,
        body_pose: Tensor | None = None,
        jaw_pose: Tensor | None = None,
        leye_pose: Tensor | None = None,
        reye_pose: Tensor | None = None,
        left_hand_pose: Tensor | None = None,
        right_hand_pose: Tensor | None = None,
        *,
        hands: int | Literal["full"],
        flat_hand_mean: bool,
    ) -> Tensor:
        """Axis-angle (T, 55, 3) of all joints, relative to the rest body with its flat hands.

        Args:
            global_orient: (T, 3).
            body_pose: (T, 63) joints 1 to 21; here and below, None is zero.
            jaw_pose, leye_pose, reye_pose: (T, 3).
            left_hand_pose, right_hand_pose: (T, 45) axis-angle, or (T, n) coefficients of the first n components.
            hands: which of the two: ``full``, or n.
            flat_hand_mean: zero hands are flat; else zero hands are the mean hand.
        """
        T = len(global_orient)
        size = 45 if hands == "full" else hands

        def given(value: Tensor | None, width: int) -> Tensor:
            value = global_orient.new_zeros(T, width) if value is None else value
            if value.shape != (T, width):
                raise ValueError(f"a part of the pose has the shape {tuple(value.shape)} instead of {(T, width)}")
            return value

        parts = [given(global_orient, 3), given(body_pose, 63)]
        parts += [given(value, 3) for value in (jaw_pose, leye_pose, reye_pose)]
        for side, value in enumerate((left_hand_pose, right_hand_pose)):
            hand = given(value, size)
            if hands != "full":
                hand = hand @ self.hand_components[side, :size]
            parts.append(hand if flat_hand_mean else hand + self.hand_mean[side])
        return torch.cat(parts, 1).unflatten(1, (len(JOINTS), 3))

    def __call__(
        self,
        betas: Tensor,
        expression: Tensor,
        pose: Tensor,
        transl: Tensor,
        *,
        axes: Literal["opengl", "opencv"] = "opengl",
    ) -> tuple[Tensor, Tensor]:
        """Vertices (T, V, 3) and joints (T, 144, 3).

        Args:
            betas: (B,) or (T, B), in standard deviations.
            expression: (E,) or (T, E), likewise.
            pose: (T, 55, 3), see :meth:`full_pose`; the root turns about the pelvis.
            transl: (T, 3), added last.
            axes: those the body is posed in, which tell how far the head is turned, and with it where the contour
                runs: y up and z to the viewer, which is what the smplx package takes every body for, or y down and z
                away. In those that are not meant, a head turned by 30 degrees gets the contour of -30.
        """
        T = len(pose)
        rotations = axis_angle_to_matrix(pose)
        betas, expression = betas.expand(T, -1), expression.expand(T, -1)
        rest = self.v_template + _blend(self.shapedirs, betas) + _blend(self.exprdirs, expression)
        joints = self.J_template + _blend(self.J_shapedirs, betas) + _blend(self.J_exprdirs, expression)
        transforms = torch.vmap(chain, (None, 0, 0))(self.parents, joints, rotations)
        feature = (rotations[:, 1:] - torch.eye(3).to(pose)).flatten(1)
        vertices = skin(transforms, self.weights, rest + _blend(self.posedirs, feature))
        turned = (transforms[..., :3] @ joints[..., None])[..., 0] + transforms[..., 3]
        points = [turned, vertices[:, EXTRA_VERTICES], self._landmarks(vertices, contour_rows(rotations, axes))]
        return vertices + transl[:, None], torch.cat(points, 1) + transl[:, None]

    def _landmarks(self, vertices: Tensor, rows: Tensor) -> Tensor:
        """Face landmarks (T, 68, 3), static before contour, on vertices (T, V, 3)."""
        T = len(vertices)
        triangles = torch.cat([self.landmark_faces.expand(T, -1), self.contour_faces[rows]], 1)
        shares = torch.cat([self.landmark_barycentrics.expand(T, -1, -1), self.contour_barycentrics[rows]], 1)
        corners = vertices[torch.arange(T)[:, None, None], self.faces[triangles]]
        return (corners * shares[..., None]).sum(2)


def _blend(dirs: Tensor, coefficients: Tensor) -> Tensor:
    """(T, N, 3) sum of displacements (N, 3, C) times coefficients (T, C)."""
    return torch.einsum("nxc,tc->tnx", dirs, coefficients)


def contour_rows(rotations: Tensor, axes: Literal["opengl", "opencv"]) -> Tensor:
    """(T,) row of the contour's table for local rotations (T, 55, 3, 3): 0 ahead, 39 and 78 turned farthest."""
    head = torch.eye(3).to(rotations).expand(len(rotations), 3, 3)
    if axes == "opencv":
        head = head * rotations.new_tensor([1.0, -1.0, -1.0])
    for joint in _NECK:
        head = head @ rotations[:, joint]
    yaw = torch.rad2deg(torch.atan2(head[:, 2, 0], torch.hypot(head[:, 0, 0], head[:, 1, 0])))
    degrees = yaw.clamp(-_FAR - 1, _FAR).round().long()
    return torch.where(degrees < -_FAR, 2 * _FAR, torch.where(degrees < 0, _FAR - degrees, degrees))
