"""LPIPS: structure on random weights, numbers on the published ones."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from soar.errors import ModelFileError
from soar.losses.lpips import _TRUNKS, Lpips, Net
from soar.models import records
from tests.conftest import model_file
from tests.report.toy import lpips_file


def random_lpips(net: Net) -> Lpips:
    generator = torch.Generator().manual_seed(0)
    tensors = {}
    for i, (out, before, kernel, _, _) in enumerate(_TRUNKS[net].convolutions):
        scale = (2 / (before * kernel**2)) ** 0.5
        tensors[f"conv{i}.weight"] = torch.randn(out, before, kernel, kernel, generator=generator) * scale
        tensors[f"conv{i}.bias"] = torch.zeros(out)
    for k, tap in enumerate(_TRUNKS[net].taps):
        tensors[f"head{k}.weight"] = torch.rand(1, _TRUNKS[net].convolutions[tap][0], 1, 1, generator=generator)
    return Lpips(net, tensors)


def images(count: int, height: int = 48, width: int = 40, seed: int = 1) -> torch.Tensor:
    return torch.rand(count, 3, height, width, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("net", ["alex", "vgg"])
def test_batches_and_cached_features_give_the_same(net: Net) -> None:
    lpips = random_lpips(net)
    a, b = images(3), images(3, seed=2)
    whole = lpips(a, b)
    assert whole.shape == (3,)
    assert bool((whole > 0).all())
    for i in range(3):
        torch.testing.assert_close(lpips(a[i : i + 1], b[i : i + 1])[0], whole[i], rtol=1e-4, atol=1e-6)
    target = lpips.features(b)
    torch.testing.assert_close(lpips.distance(lpips.features(a), target), whole)
    torch.testing.assert_close(lpips(b, a), whole)
    assert float(lpips(a, a).abs().max()) == 0
    assert lpips.spatial(lpips.features(a), target, (48, 40)).shape == (3, 1, 48, 40)


def test_features_are_unit_vectors_of_five_taps() -> None:
    features = random_lpips("vgg").features(images(2, 64, 32))
    assert [tuple(f.shape) for f in features] == [
        (2, 64, 64, 32), (2, 128, 32, 16), (2, 256, 16, 8), (2, 512, 8, 4), (2, 512, 4, 2)
    ]  # fmt: skip
    for f in features:
        lengths = f.norm(dim=1)
        torch.testing.assert_close(lengths[lengths > 0], torch.ones_like(lengths[lengths > 0]))


def test_gradient_reaches_the_image_only() -> None:
    """In float64, against a central difference; a black image (zero features under zero bias) must not give NaN."""
    lpips = random_lpips("alex").double()
    assert not list(lpips.parameters())
    assert not any(buffer.requires_grad for buffer in lpips.buffers())
    a, b = images(1).double().requires_grad_(), images(1, seed=2).double()
    lpips(a, b).sum().backward()
    direction = torch.randn(a.shape, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    step = 1e-6
    with torch.no_grad():
        slope = (lpips(a + step * direction, b) - lpips(a - step * direction, b)) / (2 * step)
    torch.testing.assert_close((a.grad * direction).sum(), slope[0], rtol=1e-4, atol=1e-8)
    # The image that normalises to zero gives zero feature vectors everywhere.
    grey = lpips.mean.expand(1, 3, 48, 40).clone().requires_grad_()
    lpips(grey, b).sum().backward()
    assert bool(torch.isfinite(grey.grad).all())


def test_unusable_input_is_refused() -> None:
    lpips = random_lpips("alex")
    for shape in ((3, 48, 48), (1, 1, 48, 48), (1, 3, 31, 48)):
        with pytest.raises(ValueError, match="at least 32 pixels"):
            lpips.features(torch.zeros(shape))
    with pytest.raises(ModelFileError, match=r"conv0\.bias") as caught:
        Lpips("alex", {})
    assert caught.value.got == "missing"


def test_weights_that_are_not_those_installed_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "lpips_alex.safetensors"
    with pytest.raises(ModelFileError, match="is missing") as caught:
        Lpips.load(path, "alex")
    assert "python -m soar models fetch" in caught.value.cure
    lpips_file(path)
    Lpips.load(path, "alex")
    records.write(tmp_path, path.name, {})
    content = bytearray(path.read_bytes())
    content[-1] ^= 1  # one bit of one weight: still a file of the right form
    path.write_bytes(content)
    with pytest.raises(ModelFileError, match="is not the file it should be"):
        Lpips.load(path, "alex")


@pytest.mark.parametrize(("net", "distance", "spatial"), [("alex", 0.81395, 0.81404), ("vgg", 0.45384, 0.45384)])
def test_black_against_white_is_the_published_number(net: Net, distance: float, spatial: float) -> None:
    lpips = Lpips.load(model_file(f"lpips_{net}.safetensors"), net)
    black, white = lpips.features(torch.zeros(1, 3, 64, 64)), lpips.features(torch.ones(1, 3, 64, 64))
    assert float(lpips.distance(black, white)) == pytest.approx(distance, abs=2e-5)
    assert float(lpips.spatial(black, white, (64, 64)).mean()) == pytest.approx(spatial, abs=2e-5)


@pytest.mark.parametrize(("net", "checker", "mirrored"), [("alex", 0.8705, 0.4099), ("vgg", 0.7444, 0.4070)])
def test_ramp_against_checkerboard_and_its_mirror(net: Net, checker: float, mirrored: float) -> None:
    """Our own first numbers, kept so that a change of layout, scaling or taps is seen."""
    lpips = Lpips.load(model_file(f"lpips_{net}.safetensors"), net)
    ramp = torch.linspace(0, 1, 64).expand(1, 3, 64, 64)
    cell = torch.arange(64) // 8
    board = ((cell[:, None] + cell) % 2).float().expand(1, 3, 64, 64)
    assert float(lpips(ramp, board)) == pytest.approx(checker, abs=2e-4)
    assert float(lpips(ramp, ramp.flip(-1))) == pytest.approx(mirrored, abs=2e-4)
