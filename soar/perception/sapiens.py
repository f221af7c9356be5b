"""Front normals by a normal network of Sapiens, which the user brings as an ONNX file (docs/normals.md).

Khirodkar et al., Sapiens: Foundation for Human Vision Models, ECCV 2024.
"""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np

from soar.models.onnx import ANY, Signature, session
from soar.perception.body_normals import FRONT_ONLY, behind
from soar.perception.brought import brought_file
from soar.perception.normal_maps import Box, Context, Crop, from_network, sampled, seen_from, settled

HEIGHT, WIDTH = 1024, 768
"""Of the network's picture."""

MEAN = np.array([123.5, 116.5, 103.5], np.float32)
STD = np.array([58.5, 57.0, 57.5], np.float32)
"""Of the colours in [0, 255] that it was taught with."""

SIGNATURE = Signature({"input": (ANY, 3, HEIGHT, WIDTH)}, {"normal": (ANY, 3, ANY, ANY)}, any_names=True)


@dataclasses.dataclass(frozen=True)
class SapiensSettings:
    """Node ``normals`` with the provider ``sapiens``.

    Attributes:
        provider: ``sapiens``.
        network: the ONNX file.
        threshold: mask value in [0, 1] from which a pixel gets normals.
        device: ``auto``, ``cpu`` or ``cuda``.
    """

    provider: Literal["sapiens"]
    network: str
    threshold: float
    device: Literal["auto", "cpu", "cuda"]


class SapiensNormals:
    """The provider ``sapiens``: the front by the network, which sees the crop with its background; the body's back.

    Raises:
        ConfigError: no file is named, or there is no such device.
        ModelFileError: the network is missing, unsafe, or of another signature.
    """

    remarks = (FRONT_ONLY,)

    def __init__(self, options: SapiensSettings, context: Context) -> None:
        path = brought_file(context.brought, "network", "normals")
        self.options, self.backend = options, context.backend
        self.session = session(path, context.threads, SIGNATURE, options.device)

    def maps(self, crop: Crop) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`soar.perception.normals.NormalProvider`; zero outside the mask."""
        inside = crop.alpha >= 255 * self.options.threshold
        height, width = inside.shape
        box = _filled_out(height, width)
        # What is beyond the crop has the mean colour.
        picture = sampled((crop.rgb - MEAN) / STD, box, WIDTH, HEIGHT)
        feed = {self.session.get_inputs()[0].name: np.ascontiguousarray(picture.transpose(2, 0, 1)[None])}
        normals = from_network(self.session.run(None, feed)[0])
        place = seen_from((0, 0, width, height), box, normals.shape[1], normals.shape[0])
        return settled(sampled(normals, place, width, height), inside), behind(crop, inside, self.backend)


def _filled_out(height: int, width: int) -> Box:
    """A crop grown about its middle to the network's aspect: stretched people have other normals."""
    tall, wide = max(height, width * HEIGHT / WIDTH), max(width, height * WIDTH / HEIGHT)
    return (width - wide) / 2, (height - tall) / 2, (width + wide) / 2, (height + tall) / 2
