"""Priors by name, with the settings that come with the project."""

import pytest

from soar.config import settings
from soar.errors import ConfigError, ModelFileError
from soar.priors.imagedream.prior import ImageDreamSettings
from soar.priors.mini import MiniProvider
from soar.priors.registry import PRIORS, prior
from tests.conftest import ROOT, conf
from tests.networks.small_prior import SIZE
from tests.priors.test_mini import file  # noqa: F401  (a fixture)


def node(option):
    """The options as Hydra composes them."""
    found = conf("prior", option)
    for parent in found.pop("defaults", []):
        if parent != "_self_":
            found = node(parent) | found
    return found


@pytest.mark.parametrize("option", PRIORS)
def test_shipped_settings_fit(option):
    assert (ROOT / "conf" / "prior" / f"{option}.yaml").is_file()
    schema, _ = PRIORS[option]
    assert settings(schema, node(option)).provider == option


def test_shipped_guidance_is_that_of_the_released_code():
    options = settings(ImageDreamSettings, node("imagedream"))
    assert (options.guidance, options.rescale, options.form) == (5.0, 0.2, "latent")
    assert options.negative.startswith("ugly, bad anatomy, blurry")
    assert settings(ImageDreamSettings, node("onnx")).form == "image"


def test_mini(file, tmp_path):  # noqa: F811
    made = prior(node("mini") | {"network": str(file), "size": SIZE}, tmp_path, 1)
    assert isinstance(made, MiniProvider)
    assert (made.size, made.guidance) == (SIZE, node("mini")["guidance"])


def test_missing_weights_are_named(tmp_path):
    with pytest.raises(ModelFileError, match="is missing") as caught:
        prior(node("imagedream") | {"source": str(tmp_path / "none.pt"), "device": "cpu"}, tmp_path, 1)
    assert "docs/priors.md" in caught.value.cure
    with pytest.raises(ModelFileError, match="is missing"):
        prior(node("onnx") | {"source": str(tmp_path)}, tmp_path, 1)


def test_unknown_names_and_settings(tmp_path):
    with pytest.raises(ConfigError, match=r"prior\.provider"):
        prior({"provider": "dream"}, tmp_path, 1)
    with pytest.raises(ConfigError, match="does not fit its schema"):
        prior(node("mini") | {"scale": 1}, tmp_path, 1)
    with pytest.raises(ConfigError, match=r"prior\.device"):
        prior(node("imagedream") | {"device": "abacus"}, tmp_path, 1)
