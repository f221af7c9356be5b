"""The silhouette term: the body's outline and the mask's, matched point by point and drawn together.

Each round renders the body, matches boundary pixels of body and mask in both directions (near, with a like normal), and
fixes the pairs; the fit then minimises the distance of the body's surface points to the mask's tangents. Both
boundaries are traced at the same resolution in the same way, so their half-pixel biases cancel.

A mask also holds hair and clothes. Their thickness over the body, one number per point of a coarse set of nodes and
constant over the clip, is estimated with the pose and then thrown away: without it limbs are shifted, and the shape
bloated, to explain a hem.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import cv2
import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from soar.body.record import BodyModel
from soar.body.robust import geman_mcclure
from soar.body.skeleton import Skeleton
from soar.geometry.cameras import Camera
from soar.raster import Pinhole, rasterise_mesh

NODES_NEAR = 8  # clothing nodes that a point of the body listens to
MARGIN = 3  # pixels around a mask's window, and at the image border, where outlines do not count


@dataclasses.dataclass(frozen=True)
class SilhouetteSettings:
    """Settings of the silhouette term. Lengths in percent of the person's box height.

    Attributes:
        weight: of the mean squared distance between outlines; 0 = off.
        sigma: Geman-McClure scale.
        rounds: how often pairs are matched anew.
        iterations: L-BFGS iterations of each round.
        scale: working resolution relative to the frames.
        threshold: mask value, 0 to 1, of the outline.
        stride: every how many boundary pixels one is used.
        normal_weight: distance that a unit difference of normals is worth in matching.
        limit: longest distance of a pair.
        clothing_weight: of the mean squared clothing, centimetres squared; 0 = the outline is the body's.
        clothing_nodes: points of the body between which clothing is interpolated.
        clothing_sigma_m: width of that interpolation, metres.
    """

    weight: float
    sigma: float
    rounds: int
    iterations: int
    scale: float
    threshold: float
    stride: int
    normal_weight: float
    limit: float
    clothing_weight: float
    clothing_nodes: int
    clothing_sigma_m: float


@dataclasses.dataclass(frozen=True)
class Outline:
    """Boundary of a binary image: points (N, 2) in pixels of the full frame, outward unit normals (N, 2), and for a
    rendered body the triangle (N,) and barycentrics (N, 3) under each point."""

    points: np.ndarray
    normals: np.ndarray
    face: np.ndarray
    barycentrics: np.ndarray


def trace(
    inside: np.ndarray, scale: float, origin: tuple[int, int], frame: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Boundary pixels of a window of the frame.

    Args:
        inside: (H, W) bool.
        scale: pixels of the window per pixel of the frame.
        origin: window's top left corner in scaled pixels.
        frame: (width, height) of the scaled frame; boundaries at its border are the image's, not the person's.

    Returns:
        points (N, 2) in frame pixels, outward normals (N, 2), and the (rows, columns) of the pixels.
    """
    mask = inside.astype(np.uint8)
    ys, xs = np.nonzero(mask - cv2.erode(mask, np.ones((3, 3), np.uint8)))
    x, y = xs + origin[0], ys + origin[1]
    keep = (x >= MARGIN) & (y >= MARGIN) & (x < frame[0] - MARGIN) & (y < frame[1] - MARGIN)
    ys, xs = ys[keep], xs[keep]
    smooth = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), 1.5)
    slope = np.stack([cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1)], -1)[ys, xs]
    normals = -slope / np.linalg.norm(slope, axis=1, keepdims=True).clip(1e-6)
    points = (np.stack([xs + origin[0], ys + origin[1]], 1) + 0.5) / scale
    return points, normals, (ys, xs)


class Silhouettes:
    """Outlines of the masks of C cameras over T frames, at the working resolution.

    Args:
        cameras: C cameras.
        masks: for each camera the T masks (H, W) uint8, any sequence that decodes one at a time.
        settings: resolution and threshold.
    """

    def __init__(
        self, cameras: Sequence[Camera], masks: Sequence[Sequence[np.ndarray]], settings: SilhouetteSettings
    ) -> None:
        self.settings = settings
        self.cameras = [
            c.resized(max(1, round(c.width * settings.scale)), max(1, round(c.height * settings.scale)))
            for c in cameras
        ]
        self.scales = [small.width / c.width for small, c in zip(self.cameras, cameras, strict=True)]
        nothing = np.zeros(0)
        self.outlines: list[list[Outline]] = []
        for camera, scale, stack in zip(self.cameras, self.scales, masks, strict=True):
            row = []
            for t in range(len(stack)):
                small = cv2.resize(stack[t], (camera.width, camera.height), interpolation=cv2.INTER_AREA)
                inside = largest(small >= 255 * settings.threshold)
                points, normals, _ = trace(inside, scale, (0, 0), (camera.width, camera.height))
                row.append(Outline(points, normals, nothing, nothing))
            self.outlines.append(row)

    def body_outline(self, c: int, vertices: np.ndarray, faces: Tensor) -> Outline:
        """Outline of the body's rendered vertices (V, 3), world metres, in camera ``c``."""
        camera = self.cameras[c]
        local = camera.to_camera(vertices)
        pixels = (local @ camera.K.T)[:, :2] / local[:, 2:].clip(1e-3)
        x0, y0 = np.maximum(np.floor(pixels.min(0)).astype(int) - MARGIN, 0)
        x1, y1 = np.minimum(np.ceil(pixels.max(0)).astype(int) + MARGIN, (camera.width, camera.height))
        if x1 <= x0 or y1 <= y0:
            return Outline(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0, int), np.zeros((0, 3)))
        window = camera.cropped(int(x0), int(y0), int(x1 - x0), int(y1 - y0))
        pinhole = Pinhole.from_K(window.K, window.width, window.height)
        fragments = rasterise_mesh(torch.from_numpy(local.astype(np.float32)), faces, pinhole, "front")
        face = np.asarray(fragments.face)
        points, normals, at = trace(face >= 0, self.scales[c], (int(x0), int(y0)), (camera.width, camera.height))
        return Outline(points, normals, face[at], np.asarray(fragments.barycentrics)[at])


def largest(inside: np.ndarray) -> np.ndarray:
    """The largest connected region of a bool image: specks elsewhere are not the person."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(inside.astype(np.uint8), connectivity=8)
    if count < 2:
        return inside
    return labels == 1 + stats[1:, cv2.CC_STAT_AREA].argmax()


@dataclasses.dataclass(frozen=True)
class Pairs:
    """Matched outline points, padded to P per frame.

    Attributes:
        rest, dirs: (T, P, 3) and (T, P, 3, B): the body point in rest space.
        weights: (T, P, A) skin weights over the active joints.
        nodes, shares: (T, P, k) clothing nodes near the body point, and their weights; rows sum to one.
        camera: (T, P) long, the pair's camera.
        focal: (T, P) its focal length in pixels.
        target, normal: (T, P, 2) point and outward normal of the mask's outline, pixels.
        unit: (T, P) pixels per percent of the person's box height.
        weight: (T, P) 1 / number of pairs of the image and of images; 0 for padding.
    """

    rest: Tensor
    dirs: Tensor
    weights: Tensor
    nodes: Tensor
    shares: Tensor
    camera: Tensor
    focal: Tensor
    target: Tensor
    normal: Tensor
    unit: Tensor
    weight: Tensor

    def loss(
        self,
        transforms: Tensor,
        betas: Tensor,
        translation: Tensor,
        projections: Tensor,
        clothing: Tensor,
        sigma: float,
    ) -> Tensor:
        """Mean robust squared distance of the outlines, percent squared.

        Args:
            transforms: (T, A, 3, 4) skinning transforms.
            betas: (B,).
            translation: (T, 3) metres.
            projections: (C, 3, 4) pixels from world.
            clothing: (nodes,) thickness over the body, metres.
            sigma: Geman-McClure scale, percent.
        """
        blend = (self.weights @ transforms.flatten(-2)).unflatten(-1, (3, 4))
        points = (blend[..., :3] @ (self.rest + self.dirs @ betas)[..., None]).squeeze(-1) + blend[..., 3]
        world = points + translation[:, None]
        P = projections[self.camera]
        q = (P[..., :3] @ world[..., None]).squeeze(-1) + P[..., 3]
        depth = q[..., 2:].clamp_min(1e-3)
        distance = ((q[..., :2] / depth - self.target) * self.normal).sum(-1)
        # At an outline the surface is seen edge-on, so thickness moves it along the outline's normal.
        thickness = (self.shares * clothing[self.nodes]).sum(-1) * self.focal / depth[..., 0].detach()
        return (self.weight * geman_mcclure(((distance + thickness) / self.unit) ** 2, sigma)).sum()


def match(
    model: BodyModel,
    skeleton: Skeleton,
    outlines: Silhouettes,
    vertices: np.ndarray,
    unit: np.ndarray,
    cameras: Sequence[Camera],
) -> Pairs:
    """Pair the outlines of the body and of the masks.

    Args:
        model: the body.
        skeleton: its collapsed skeleton.
        outlines: the masks.
        vertices: (T, V, 3) the body now, world metres.
        unit: (C, T) pixels per percent of the person's box height.
        cameras: C full-size cameras.
    """
    settings = outlines.settings
    frames: list[list[tuple[int, Outline, np.ndarray, Outline, np.ndarray]]] = []
    for t in range(len(vertices)):
        images = []
        for c in range(len(cameras)):
            body, mask = outlines.body_outline(c, vertices[t], model.faces), outlines.outlines[c][t]
            if len(body.points) and len(mask.points):
                a, b = _pair(body, mask, unit[c, t], settings)
                if len(a):
                    images.append((c, body, a, mask, b))
        frames.append(images)
    used = sum(len(images) for images in frames)
    P = max(1, max(sum(len(image[2]) for image in images) for images in frames))
    like = model.v_template
    T, A, B = len(vertices), len(skeleton.active), model.shapedirs.shape[-1]
    carried = skeleton.carried(model.weights)
    out = {
        "rest": like.new_zeros(T, P, 3), "dirs": like.new_zeros(T, P, 3, B), "weights": like.new_zeros(T, P, A),
        "nodes": torch.zeros(T, P, NODES_NEAR, dtype=torch.long), "shares": like.new_zeros(T, P, NODES_NEAR),
        "camera": torch.zeros(T, P, dtype=torch.long), "focal": like.new_ones(T, P),
        "target": like.new_zeros(T, P, 2), "normal": like.new_zeros(T, P, 2),
        "unit": like.new_ones(T, P), "weight": like.new_zeros(T, P),
    }  # fmt: skip
    nodes, shares = clothing_nodes(like, settings)
    for t, images in enumerate(frames):
        start = 0
        for c, body, a, mask, b in images:
            rows = slice(start, start + len(a))
            corners = model.faces[torch.from_numpy(body.face[a]).long()]
            weights = like.new_tensor(body.barycentrics[a])[..., None]
            out["rest"][t, rows] = (weights * model.v_template[corners]).sum(1)
            out["dirs"][t, rows] = (weights[..., None] * model.shapedirs[corners]).sum(1)
            out["weights"][t, rows] = (weights * carried[corners]).sum(1)
            # The triangle's first corner stands for the point: nodes are farther apart than a triangle is wide.
            out["nodes"][t, rows], out["shares"][t, rows] = nodes[corners[:, 0]], shares[corners[:, 0]]
            out["camera"][t, rows] = c
            out["focal"][t, rows] = float(cameras[c].K[0, 0])
            out["target"][t, rows] = like.new_tensor(mask.points[b])
            out["normal"][t, rows] = like.new_tensor(mask.normals[b])
            out["unit"][t, rows] = float(unit[c, t])
            out["weight"][t, rows] = 1 / (len(a) * used)
            start += len(a)
    return Pairs(**out)


def clothing_nodes(vertices: Tensor, settings: SilhouetteSettings) -> tuple[Tensor, Tensor]:
    """The ``k`` nodes nearest to each rest vertex (V, 3), as places in the list of nodes (V, k), and their weights.

    Nodes are vertices that lie as far from each other as possible.
    """
    chosen, distance = [0], (vertices - vertices[0]).norm(dim=1)
    for _ in range(settings.clothing_nodes - 1):
        chosen.append(int(distance.argmax()))
        distance = torch.minimum(distance, (vertices - vertices[chosen[-1]]).norm(dim=1))
    points = vertices.numpy()
    apart, near = cKDTree(points[chosen]).query(points, k=NODES_NEAR)
    shares = vertices.new_tensor(np.exp(-((apart / settings.clothing_sigma_m) ** 2) / 2) + 1e-12)
    return torch.from_numpy(near).long(), shares / shares.sum(1, keepdim=True)


def _pair(body: Outline, mask: Outline, unit: float, settings: SilhouetteSettings) -> tuple[np.ndarray, np.ndarray]:
    """Indices (N,) of body points and (N,) of mask points, matched in both directions."""
    b, m = (np.concatenate([o.points / unit, settings.normal_weight * o.normals], 1) for o in (body, mask))
    some_b, some_m = np.arange(0, len(b), settings.stride), np.arange(0, len(m), settings.stride)
    _, to_mask = cKDTree(m).query(b[some_b])
    _, to_body = cKDTree(b).query(m[some_m])
    at_body, at_mask = np.concatenate([some_b, to_body]), np.concatenate([to_mask, some_m])
    near = np.linalg.norm(b[at_body, :2] - m[at_mask, :2], axis=1) < settings.limit
    return at_body[near], at_mask[near]
