"""The body as the camera of some crops sees it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

import numpy as np
import torch
from torch import Tensor

from soar.body.lbs import pose_vertices
from soar.body.motion import BodyMotion
from soar.body.record import BodyModel
from soar.raster import Pinhole


def posed_in_crops(
    model: BodyModel, motion: BodyMotion, crops: Mapping[str, np.ndarray], chosen: Iterable[int]
) -> Iterator[tuple[int, Tensor, Pinhole]]:
    """Number, posed vertices (V, 3) in camera space, metres, and view of the ``chosen`` ones of a camera's crops."""
    _, height, width = crops["alpha"].shape
    pose = torch.from_numpy(np.asarray(crops["T_cam_from_world"], np.float32))
    rotations = motion.rotations
    for i in chosen:
        frame = int(crops["frame_index"][i])
        world = pose_vertices(model, motion.betas, rotations[frame], motion.translation[frame])
        vertices = world @ pose[:3, :3].T + pose[:3, 3]
        yield i, vertices, Pinhole.from_K(crops["K"][i], width, height)
