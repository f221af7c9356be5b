"""The posed body in a camera's crops, against skinning written out."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from soar.body.motion import BodyMotion
from soar.stages._posed import posed_in_crops
from tests.avatar import toy

FRAME_OF = [2, 0, 3]  # the frame of each crop
HEIGHT, WIDTH = 40, 30


def moving() -> BodyMotion:
    """The toy's motion, wandering."""
    motion = toy.motion(4)
    return dataclasses.replace(motion, translation=torch.arange(12.0).reshape(4, 3) * 0.1)


def crops() -> dict[str, np.ndarray]:
    """Of a camera at an angle; every crop has intrinsics of its own, double precision as in the files."""
    K = [[[100.0 + i, 0, 15 + i], [0, 110.0 + i, 20 + 2 * i], [0, 0, 1]] for i in range(len(FRAME_OF))]
    return {
        "alpha": np.zeros((len(FRAME_OF), HEIGHT, WIDTH), np.uint8),
        "K": np.array(K),
        "T_cam_from_world": toy.camera(0.7).double().numpy(),
        "frame_index": np.array(FRAME_OF),
    }


def in_camera(frame: int) -> np.ndarray:
    """Vertices (V, 3): the root turns, then the upper bone, whose tip only follows; then the body moves."""
    body, motion = toy.body(torch.float64), moving()
    beta = float(motion.betas[0])
    rest = body.v_template.numpy() * (1 + 0.1 * beta)
    joint = np.array([0, 0, 0.5 + 0.05 * beta])
    root, upper = (Rotation.from_rotvec(motion.pose[frame, j].double().numpy()).as_matrix() for j in (0, 1))
    low = rest @ root.T
    high = ((rest - joint) @ upper.T + joint) @ root.T
    share = body.weights[:, :1].numpy()
    world = share * low + (1 - share) * high + motion.translation[frame].double().numpy()
    T = crops()["T_cam_from_world"]
    return world @ T[:3, :3].T + T[:3, 3]


@pytest.mark.parametrize("chosen", [range(3), [2, 0], []], ids=["all", "two", "none"])
def test_chosen_crops_show_the_body_of_their_frame_through_their_camera(chosen: list[int]) -> None:
    found = list(posed_in_crops(toy.body(), moving(), crops(), chosen))
    assert [i for i, _, _ in found] == list(chosen)
    for i, vertices, pinhole in found:
        expected = in_camera(FRAME_OF[i])
        torch.testing.assert_close(vertices.double(), torch.from_numpy(expected), rtol=0, atol=2e-6)
        assert np.abs(expected - in_camera(FRAME_OF[i - 1])).max() > 0.05  # another frame is elsewhere
        assert dataclasses.astuple(pinhole) == (100 + i, 110 + i, 15 + i, 20 + 2 * i, WIDTH, HEIGHT)
