"""Checkpoints are read safely, and every key is accounted for."""

import pickle

import pytest
import torch

from soar.errors import ModelFileError
from soar.priors.imagedream.checkpoint import CLIP, UNET, VAE, Checkpoint, Entry, plain
from soar.priors.imagedream.networks import TorchNetworks
from soar.priors.imagedream.schedule import alphas_cumprod
from soar.priors.imagedream.unet import UNet
from tests.priors.imagedream.small import SHAPE, filled

CPU = torch.device("cpu")


def never(key):
    return False


@pytest.fixture(scope="module")
def tensors():
    state = {f"{UNET}{key}": value for key, value in filled(UNet(SHAPE, 4)).state_dict().items()}
    return state | {
        "alphas_cumprod": alphas_cumprod().float(),
        "betas": torch.zeros(1000),
        f"{CLIP}logit_scale": torch.ones([]),
    }


@pytest.fixture
def saved(tmp_path, tensors):
    def save(changed=None, without=()):
        path = tmp_path / "checkpoint.pt"
        torch.save({key: value for key, value in (tensors | (changed or {})).items() if key not in without}, path)
        return path

    return save


def planned():
    with torch.device("meta"):
        return UNet(SHAPE, 4)


def load(path, dtype=torch.float32):
    made = planned()
    Checkpoint(path).load(UNET, made, plain(made), never, CPU, dtype)
    return made


@pytest.mark.parametrize("dtype", [torch.float32, torch.float16])
def test_every_weight_arrives(saved, tensors, dtype):
    made = load(saved(), dtype)
    assert not made.training
    for key, value in made.state_dict().items():
        assert torch.equal(value, tensors[UNET + key].to(dtype))
    assert not any(parameter.requires_grad for parameter in made.parameters())


def test_weights_outlive_the_file(saved):
    path = saved()
    made = load(path)
    before = made.out[2].weight.clone()
    path.write_bytes(bytes(path.stat().st_size))
    assert torch.equal(made.out[2].weight, before)


def test_missing_key_is_named(saved):
    with pytest.raises(ModelFileError, match="missing below model") as caught:
        load(saved(without=[f"{UNET}out.2.bias"]))
    assert caught.value.got == "out.2.bias"
    assert "ipmv" in caught.value.cure


def test_unexpected_keys_are_named(saved):
    more = {f"{UNET}extra.{k}": torch.zeros(1) for k in range(7)}
    with pytest.raises(ModelFileError, match="unexpected keys below") as caught:
        load(saved(more))
    assert "extra.0, " in caught.value.got
    assert caught.value.got.endswith("and 2 more")


def test_other_shape_is_named(saved):
    with pytest.raises(ModelFileError, match="other shapes") as caught:
        load(saved({f"{UNET}out.2.bias": torch.zeros(5)}))
    assert caught.value.got == "out.2.bias (5,) for (4,)"


def test_keys_of_no_part_are_refused(saved):
    with pytest.raises(ModelFileError, match="no part") as caught:
        Checkpoint(saved({"control_model.weight": torch.zeros(1)}))
    assert caught.value.got == "control_model.weight"


@pytest.mark.parametrize("schedule", [torch.linspace(1, 0, 1000), alphas_cumprod()[:500]])
def test_another_schedule_is_refused(saved, schedule):
    with pytest.raises(ModelFileError, match="noise schedule"):
        Checkpoint(saved({"alphas_cumprod": schedule}))


class Malice:
    def __reduce__(self):
        return print, ("this must not run",)


def test_code_in_a_checkpoint_never_runs(tmp_path, capsys):
    path = tmp_path / "evil.pt"
    torch.save({"betas": Malice()}, path)
    with pytest.raises(ModelFileError, match="cannot be read safely"):
        Checkpoint(path)
    assert "must not run" not in capsys.readouterr().out


@pytest.mark.parametrize("content", [b"", b"nothing", pickle.dumps({"a": 1})])
def test_damaged_files_are_refused(tmp_path, content):
    path = tmp_path / "damaged.pt"
    path.write_bytes(content)
    with pytest.raises(ModelFileError, match="cannot be read safely"):
        Checkpoint(path)


def test_truncated_file_is_refused(saved):
    path = saved()
    path.write_bytes(path.read_bytes()[:-4000])
    with pytest.raises(ModelFileError, match="cannot be read safely"):
        Checkpoint(path)


def test_missing_file_and_other_content(tmp_path):
    with pytest.raises(ModelFileError, match="is missing"):
        Checkpoint(tmp_path / "none.pt")
    torch.save({"betas": 3}, tmp_path / "numbers.pt")
    with pytest.raises(ModelFileError, match="something else"):
        Checkpoint(tmp_path / "numbers.pt")


def test_one_tensor_may_fill_several(tmp_path):
    """Queries, keys and values of OpenCLIP are one tensor; convolutions of 1 x 1 become linear layers."""
    stacked, convolution = torch.arange(12.0).reshape(6, 2), torch.arange(4.0).reshape(2, 2, 1, 1)
    path = tmp_path / "stacked.pt"
    torch.save({f"{VAE}qkv": stacked, f"{VAE}conv": convolution, "alphas_cumprod": alphas_cumprod().float()}, path)
    made = torch.nn.ModuleDict({name: torch.nn.Linear(2, 2, bias=False) for name in "qkvc"})
    layout = {
        "qkv": Entry((6, 2), tuple(f"{name}.weight" for name in "qkv")),
        "conv": Entry((2, 2, 1, 1), ("c.weight",)),
    }
    Checkpoint(path).load(VAE, made, layout, never, CPU, torch.float32)
    assert torch.equal(torch.cat([made[name].weight for name in "qkv"]), stacked)
    assert torch.equal(made["c"].weight, convolution[..., 0, 0])


def test_networks_compute_in_the_precision_of_the_device(saved):
    networks = TorchNetworks(Checkpoint(saved()), 4, CPU)
    assert networks.dtype == torch.float32
    with pytest.raises(ModelFileError, match="missing below"):  # a small checkpoint is none of the released ones
        networks.unet
