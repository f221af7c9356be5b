"""The two means of tau."""

import math

import torch

from soar.metrics.bor import body_occlusion_ratio


def test_plain_and_area_weighted() -> None:
    tau, scales = torch.tensor([1.0, 0.0, 0.0]), torch.tensor([0.02, 0.01, 0.01])
    plain, area = body_occlusion_ratio(tau, scales)
    assert math.isclose(plain, 1 / 3)
    assert math.isclose(area, 4 / 6, rel_tol=1e-6)
