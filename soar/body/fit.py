"""The fit of shape and poses to keypoints and masks.

The paper's objective (equation 3): robust reprojection error, smoothness of rotations over time, and staying near the
start. As printed its smoothness term is constant; it is read as the squared angle between consecutive rotations.
Beyond the paper, switched by weights: silhouettes, a constant rest-space offset for each keypoint (detector and body do
not mean the same hip), small turns of the cameras, priors on shape and pose, metric landmarks for a single camera.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from soar.body.initial import InitialSettings, Poses
from soar.body.lbs import height, skin
from soar.body.motion import BodyMotion
from soar.body.observations import Observations
from soar.body.openpose import BODY, COUNT, GROUPS, INDEX
from soar.body.record import BodyModel
from soar.body.robust import geman_mcclure, minimise
from soar.body.silhouette import Pairs, Silhouettes, SilhouetteSettings, match
from soar.body.skeleton import Skeleton, collapse
from soar.body.triangulate import TriangulationSettings
from soar.errors import ConfigError
from soar.geometry.cameras import Camera
from soar.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle

STEP_M, LEVER_M = 0.02, 0.4  # metres: a typical step of a keypoint, and a typical distance of keypoints from a joint
STEP_CAMERA = 0.005  # radians: a typical error of a calibrated camera's rotation
CAMERAS_TO_TURN = 3  # with fewer, a turned camera and a moved body look alike


@dataclasses.dataclass(frozen=True)
class Weights:
    """Weights of the terms, all means over frames.

    Attributes:
        data: robust squared reprojection error, percent of the box height squared, mean over confident keypoints.
        smooth: squared angle between consecutive rotations of a joint, radians squared, sum over joints.
        preserve: squared distance from the start: angles (radians) of all joints and, over the clip, betas.
        pose: squared joint angles from the rest pose times stiffness, radians squared, sum over joints.
        shape: squared betas, sum.
        offset: squared keypoint offsets, centimetres squared, mean over keypoints.
        acceleration: squared second difference of the body's keypoints over time, centimetres squared, mean.
        camera: squared turns of the cameras, radians squared, sum; 0 holds them, as do fewer than three cameras.
        world: robust squared distance of keypoints to the metric landmarks about the hips, centimetres squared, mean.
        stature: squared deviation from the given stature, centimetres squared.
    """

    data: float
    smooth: float
    preserve: float
    pose: float
    shape: float
    offset: float
    acceleration: float
    camera: float
    world: float
    stature: float


@dataclasses.dataclass(frozen=True)
class FitSettings:
    """Settings of :func:`fit_body` (node ``body``).

    Attributes:
        provider: ``fit``, or ``dataset`` where the dataset gives the body and the stage fits nothing.
        cameras: fit to all cameras, or to the training cameras only.
        min_confidence: keypoints below count as not seen.
        triangulation, initial: the start.
        sigma: Geman-McClure scale of the reprojection error, percent of the person's box height.
        world_sigma_m: Geman-McClure scale of the distance to metric landmarks, metres.
        groups: factor of each group of keypoints (see :data:`soar.body.openpose.GROUPS`).
        offsets: give each keypoint a constant offset in rest space.
        weights: of the terms.
        epochs: calls of the optimiser on keypoints, before silhouettes.
        iterations: L-BFGS iterations of one call.
        silhouette: the silhouette term.
    """

    provider: Literal["fit", "dataset"]
    cameras: Literal["all", "train"]
    min_confidence: float
    triangulation: TriangulationSettings
    initial: InitialSettings
    sigma: float
    world_sigma_m: float
    groups: dict[str, float]
    offsets: bool
    weights: Weights
    epochs: int
    iterations: int
    silhouette: SilhouetteSettings

    def __post_init__(self) -> None:
        if set(self.groups) != set(GROUPS):
            raise ConfigError(
                "body.groups does not name the keypoint groups", expected=", ".join(GROUPS), got=", ".join(self.groups)
            )


class Objective:
    """The terms of one fit over T frames and C cameras; its variables are leaf tensors.

    Args:
        model: the body.
        skeleton: its collapsed skeleton.
        seen: what the cameras saw.
        start: where the fit starts; rotations are optimised as turns from there.
        settings: weights and scales.
        stature: body height in metres, or None.
    """

    def __init__(
        self,
        model: BodyModel,
        skeleton: Skeleton,
        seen: Observations,
        start: Poses,
        settings: FitSettings,
        stature: float | None,
    ) -> None:
        like = model.v_template
        self.settings, self.skeleton, self.start, self.stature = settings, skeleton, start, stature
        self.given = tuple(seen.cameras)
        self.turned = settings.weights.camera > 0 and len(seen.cameras) >= CAMERAS_TO_TURN
        # L-BFGS sees each variable in the step that moves keypoints by about STEP_M; a variable of one frame has a T-th
        # of the influence on a mean over frames, hence the root.
        per_frame = STEP_M * len(start.translation) ** 0.5
        spread = model.shapedirs.flatten(0, 1).square().mean(0).sqrt()
        self.scales = {
            "betas": (STEP_M / spread.clamp_min(1e-4)).clamp_max(2.0),
            "turns": like.new_tensor(per_frame / LEVER_M),
            "translation": like.new_tensor(per_frame),
            "offsets": like.new_tensor(STEP_M * len(BODY) ** 0.5),
            "cameras": like.new_tensor(STEP_CAMERA),
            "clothing": like.new_tensor(STEP_M),
        }
        self.variables = {
            "betas": torch.zeros_like(start.betas),
            "turns": like.new_zeros(*start.rotations.shape[:2], 3),
            "translation": torch.zeros_like(start.translation),
            "offsets": torch.zeros_like(start.offsets),
            "cameras": like.new_zeros(len(seen.cameras), 3),
            "clothing": like.new_zeros(settings.silhouette.clothing_nodes),
        }
        self.K = like.new_tensor(np.stack([c.K for c in seen.cameras]))
        self.extrinsics = like.new_tensor(np.stack([c.T_cam_from_world[:3] for c in seen.cameras]))
        self.turn_to_camera = like.new_tensor(np.stack([c.R for c in seen.cameras]))
        factor = np.zeros(COUNT)
        for group, indices in GROUPS.items():
            factor[list(indices)] = settings.groups[group]
        factor[~model.keypoint_valid.numpy()] = 0
        weight = seen.confidence * factor
        self.weight = like.new_tensor(weight)
        self.total = float((factor * (seen.confidence > 0)).sum().clip(1e-9))
        self.points = like.new_tensor(seen.points)
        self.unit = like.new_tensor(seen.box_height() / 100)
        self.world = like.new_tensor(np.nan_to_num(seen.world))
        self.valid = model.keypoint_valid[: len(BODY)]
        self.world_weight = self.weight[:, :, : len(BODY)] * like.new_tensor(np.isfinite(seen.world).all(-1))
        self.height = height(model)
        self.pairs: Pairs | None = None

    @property
    def parameters(self) -> list[Tensor]:
        """The leaf tensors that are optimised."""
        held = {
            "offsets": not self.settings.offsets,
            "cameras": not self.turned,
            "clothing": self.pairs is None or not self.settings.silhouette.clothing_weight,
        }
        return [v.requires_grad_() for name, v in self.variables.items() if not held.get(name)]

    def camera_turns(self) -> Tensor:
        """(C, 3, 3) rotations applied after each camera's own."""
        return axis_angle_to_matrix(self.variables["cameras"] * self.scales["cameras"])

    @torch.no_grad()
    def cameras(self) -> tuple[Camera, ...]:
        """The cameras as they are turned now."""
        if not self.turned:
            return self.given
        return tuple(c.turned(R.numpy()) for c, R in zip(self.given, self.camera_turns().cpu(), strict=True))

    def poses(self) -> Poses:
        """Shape and poses at the variables now."""
        step = {name: value * self.scales[name] for name, value in self.variables.items()}
        return Poses(
            betas=self.start.betas + step["betas"],
            rotations=self.start.rotations @ axis_angle_to_matrix(step["turns"]),
            translation=self.start.translation + step["translation"],
            offsets=self.start.offsets + step["offsets"],
        )

    def terms(self) -> Mapping[str, Tensor]:
        """Every weighted term at the current variables."""
        w = self.settings.weights
        now = self.poses()
        betas, rotations, translation, offsets = now.betas, now.rotations, now.translation, now.offsets
        transforms = self.skeleton.transforms(betas, rotations)
        points = self.skeleton.keypoints(transforms, betas, translation, offsets)
        projections = self.K @ self.camera_turns() @ self.extrinsics
        out = {"data": w.data * self._data(points, projections)}
        T = len(rotations)
        if w.smooth and T > 1:
            out["smooth"] = w.smooth * ((rotations[1:] - rotations[:-1]) ** 2).sum() / 2 / (T - 1)
        if w.preserve:
            angle = ((rotations - self.start.rotations) ** 2).sum() / 2 / T
            out["preserve"] = w.preserve * (angle + ((betas - self.start.betas) ** 2).sum())
        if w.pose:
            eye = torch.eye(3, dtype=rotations.dtype, device=rotations.device)
            square = ((rotations - eye) ** 2).sum((-1, -2)) / 2
            out["pose"] = w.pose * (self.skeleton.stiffness * square).sum() / T
        if w.shape:
            out["shape"] = w.shape * (betas**2).sum()
        if w.offset and self.settings.offsets:
            out["offset"] = w.offset * 1e4 * (offsets**2).sum(-1).mean()
        if w.acceleration and T > 2:
            body = points[:, : len(BODY)][:, self.valid]
            second = body[2:] - 2 * body[1:-1] + body[:-2]
            out["acceleration"] = w.acceleration * 1e4 * (second**2).sum(-1).mean()
        if self.turned:
            out["camera"] = w.camera * ((self.variables["cameras"] * self.scales["cameras"]) ** 2).sum()
        if w.world:
            out["world"] = w.world * self._world(points)
        if w.stature and self.stature is not None:
            mean, slope = self.height
            out["stature"] = w.stature * 1e4 * (mean + slope @ betas - self.stature) ** 2
        if self.pairs is not None:
            s = self.settings.silhouette
            clothing = self.variables["clothing"] * self.scales["clothing"]
            distance = self.pairs.loss(transforms, betas, translation, projections, clothing, s.sigma)
            out["silhouette"] = s.weight * distance
            if s.clothing_weight:
                out["clothing"] = s.clothing_weight * 1e4 * (clothing**2).mean()
        return out

    def _data(self, points: Tensor, P: Tensor) -> Tensor:
        q = torch.einsum("cij,tkj->ctki", P[..., :3], points) + P[:, None, None, :, 3]
        square = ((q[..., :2] / q[..., 2:].clamp_min(1e-3) - self.points) ** 2).sum(-1) / self.unit[..., None] ** 2
        return (self.weight * geman_mcclure(square, self.settings.sigma)).sum() / self.total

    def _world(self, points: Tensor) -> Tensor:
        body = points[:, : len(BODY)]
        local = torch.einsum("cij,tkj->ctki", self.turn_to_camera, body - body[:, INDEX["mid_hip"], None])
        square = 1e4 * ((local - self.world) ** 2).sum(-1)
        robust = geman_mcclure(square, 100 * self.settings.world_sigma_m)
        return (self.world_weight * robust).sum() / self.world_weight.sum().clamp_min(1e-9)


@dataclasses.dataclass(frozen=True)
class Fit:
    """What a fit found.

    Attributes:
        motion: shape and poses, float32.
        cameras: the cameras fitted to, with their turns.
        history: the value of every term after the keypoint epochs and after each silhouette round.
    """

    motion: BodyMotion
    cameras: tuple[Camera, ...]
    history: list[dict[str, float]]


def fit_body(
    model: BodyModel,
    seen: Observations,
    start: Poses,
    settings: FitSettings,
    *,
    silhouettes: Silhouettes | None = None,
    stature: float | None = None,
) -> Fit:
    """Fit one shape and T poses.

    Args:
        model: the body; its dtype is the fit's.
        seen: keypoints of the cameras to fit to.
        start: initial shape and poses.
        settings: objective and schedule.
        silhouettes: outlines of the same cameras' masks; None leaves the term out.
        stature: the subject's height in metres, if known.

    Returns:
        motion, cameras and the course of the terms.

    Raises:
        NumericalError: a term became NaN or infinite, naming it.
    """
    skeleton = collapse(model)
    objective = Objective(model, skeleton, seen, start, settings, stature)
    history = [
        minimise(
            objective.terms,
            objective.parameters,
            steps=settings.epochs,
            iterations=settings.iterations,
            what="the body fit",
        )
    ]
    if silhouettes is not None and settings.silhouette.weight > 0:
        unit = seen.box_height() / 100
        for _ in range(settings.silhouette.rounds):
            vertices = posed_vertices(model, skeleton, objective.poses())
            objective.pairs = match(model, skeleton, silhouettes, vertices, unit, objective.cameras())
            history.append(
                minimise(
                    objective.terms, objective.parameters, steps=1, iterations=settings.silhouette.iterations,
                    what="the body fit to silhouettes",
                )
            )  # fmt: skip
    with torch.no_grad():
        end = objective.poses()
        pose = matrix_to_axis_angle(skeleton.full_rotations(end.rotations, len(model.J_template)))
    motion = BodyMotion(end.betas.float(), pose.float(), end.translation.float(), end.offsets.float())
    return Fit(motion, objective.cameras(), history)


@torch.no_grad()
def posed_vertices(model: BodyModel, skeleton: Skeleton, poses: Poses) -> np.ndarray:
    """(T, V, 3) world vertices, one frame at a time to bound memory."""
    carried = skeleton.carried(model.weights)
    rest = model.v_template + model.shapedirs @ poses.betas
    transforms = skeleton.transforms(poses.betas, poses.rotations)
    return np.stack([(skin(a, carried, rest) + t).numpy() for a, t in zip(transforms, poses.translation, strict=True)])
