"""Datasets: where recordings come from, and the record of a sequence every stage starts from.

An adapter is one class behind :class:`soar.datasets.capture.Adapter`; the table below lists them by the name that
``adapter`` has in ``conf/dataset``. Importing this package loads no numerical library.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from soar.config import settings
from soar.datasets.cameras import Cameras, CamerasSettings
from soar.datasets.demo import Demo, DemoSettings
from soar.datasets.video import Video, VideoSettings
from soar.errors import ConfigError

if TYPE_CHECKING:
    from soar.datasets.capture import Adapter

ADAPTERS: dict[str, tuple[type, type]] = {
    "demo": (Demo, DemoSettings),
    "video": (Video, VideoSettings),
    "cameras": (Cameras, CamerasSettings),
}


def adapter(node: Mapping[str, Any]) -> Adapter:
    """The adapter a ``dataset`` configuration node describes.

    Raises:
        ConfigError: no such adapter, or a key that its schema does not know.
    """
    name = node.get("adapter")
    if name not in ADAPTERS:
        raise ConfigError("unknown dataset adapter", expected=", ".join(ADAPTERS), got=repr(name))
    kind, schema = ADAPTERS[name]
    return kind(settings(schema, node, "dataset"))
