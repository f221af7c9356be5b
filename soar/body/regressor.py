"""Keypoints of a body as weighted sums of its vertices and joints."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import torch
from torch import Tensor

from soar.body import openpose

Row = dict[int, float]
"""Column of [vertices | joints] -> weight; the weights of a keypoint sum to one."""

MIDDLES = {"neck": ("left_shoulder", "right_shoulder"), "mid_hip": ("left_hip", "right_hip")}
"""Keypoints that are the middle of two others, as the keypoint stage makes them of its detector."""


def mean(rows: Iterable[Row]) -> Row:
    """The row of the mean of some keypoints."""
    parts = list(rows)
    out: Row = {}
    for part in parts:
        for column, value in part.items():
            out[column] = out.get(column, 0.0) + value / len(parts)
    return out


def fields(rows: Mapping[str, Row]) -> dict[str, Tensor]:
    """The fields ``keypoint_*`` of a body record; a keypoint without a row is one that the body lacks."""
    ordered: Sequence[Row] = [rows.get(name, {}) for name in openpose.NAMES]
    entries = [(k, column, value) for k, row in enumerate(ordered) for column, value in row.items()]
    index = np.array([(k, c) for k, c, _ in entries], np.int64)
    return {
        "keypoint_rows": torch.from_numpy(index[:, 0]),
        "keypoint_columns": torch.from_numpy(index[:, 1]),
        "keypoint_values": torch.tensor([value for *_, value in entries], dtype=torch.float32),
        "keypoint_valid": torch.tensor([bool(row) for row in ordered]),
    }
