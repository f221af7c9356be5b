"""Cameras are told as ImageDream was taught: its front is our azimuth 0."""

import math

import numpy as np
import torch

from soar.priors.imagedream.cameras import embedding


def generator_matrix(azimuth, elevation):
    """The reference generator, whose azimuth 0 is 90 degrees before the front: a y-up camera looks at the origin, and
    the world is then turned so that z is up."""
    a, e = math.radians(azimuth + 90), math.radians(elevation)
    place = np.array([math.cos(e) * math.sin(a), math.sin(e), math.cos(e) * math.cos(a)])
    right = np.cross([0.0, 1.0, 0.0], place)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(place, right), place], 1)
    pose[:3, 3] = place
    return np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1.0]]) @ pose


def test_front_camera():
    expected = [[0, 0, 1, 1], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]]
    matrix = embedding(torch.zeros(1), torch.zeros(1)).reshape(4, 4)
    torch.testing.assert_close(matrix, torch.tensor(expected).float())


def test_reference_generator_agrees():
    azimuth, elevation = torch.tensor([0.0, 90.0, 180.0, 270.0, 33.0, -71.0]), torch.tensor([0.0, 5, 15, -15, 60, -60])
    expected = [generator_matrix(a, e).ravel() for a, e in zip(azimuth.tolist(), elevation.tolist(), strict=True)]
    np.testing.assert_allclose(embedding(azimuth, elevation).numpy(), expected, atol=1e-6)


def test_the_left_side_is_seen_at_90_degrees():
    """The person faces +x and their left is +y: a front camera has it on its right, one at 90 degrees stands there."""
    front, left = embedding(torch.tensor([0.0, 90.0]), torch.zeros(2)).reshape(2, 4, 4)
    torch.testing.assert_close(front[:3, 0], torch.tensor([0.0, 1.0, 0.0]), atol=1e-6, rtol=0)
    torch.testing.assert_close(left[:3, 3], torch.tensor([0.0, 1.0, 0.0]), atol=1e-6, rtol=0)
