"""Datasets: where recordings come from, and the record of a sequence every stage starts from.

An adapter is one class behind :class:`soar.datasets.capture.Adapter`; the table below lists them by the name that
``adapter`` has in ``conf/dataset``. Importing this package loads no numerical library, and no adapter: an adapter is
code of the stages that use it only (:func:`soar.workflow.fingerprint`).
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from soar.config import settings
from soar.errors import ConfigError

if TYPE_CHECKING:
    from soar.datasets.capture import Adapter
    from soar.datasets.truth import Truth

ADAPTERS: dict[str, tuple[str, str, str]] = {
    "demo": ("soar.datasets.demo", "Demo", "DemoSettings"),
    "video": ("soar.datasets.video", "Video", "VideoSettings"),
    "cameras": ("soar.datasets.cameras", "Cameras", "CamerasSettings"),
    "synthetic": ("soar.datasets.synthetic", "Synthetic", "SyntheticDatasetSettings"),
}
"""Name -> module, class of the adapter, class of its settings."""


def _entry(node: Mapping[str, Any]) -> tuple[str, str, str]:
    name = node.get("adapter")
    if name not in ADAPTERS:
        raise ConfigError("unknown dataset adapter", expected=", ".join(ADAPTERS), got=repr(name))
    return ADAPTERS[name]


def adapter_module(node: Mapping[str, Any]) -> str:
    """The module of the adapter that a ``dataset`` configuration node names; errors as :func:`adapter`."""
    return _entry(node)[0]


def adapter(node: Mapping[str, Any]) -> Adapter:
    """The adapter a ``dataset`` configuration node describes.

    Raises:
        ConfigError: no such adapter, or a key that its schema does not know.
    """
    module, kind, schema = _entry(node)
    home = importlib.import_module(module)
    return getattr(home, kind)(settings(getattr(home, schema), node, "dataset"))


def known(node: Mapping[str, Any], sequence: str) -> Truth:
    """What the dataset that a configuration node describes knows of a sequence besides its footage.

    Raises:
        ConfigError: nothing; or as :func:`adapter`.
    """
    truth = adapter(node).capture(sequence).truth
    if truth is None:
        raise ConfigError(
            f"the dataset {node['name']} knows nothing of {sequence} besides its footage",
            cure="choose a dataset that does, such as dataset=synthetic",
        )
    return truth
