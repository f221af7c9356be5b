"""Every form of file and folder that a user may bring, with the check that its reader makes and the line that uses it.

Signatures and readers are the providers' own: what ``python -m soar models check`` says is what the stage will do.
"""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
from omegaconf import OmegaConf

from soar.body.smplx_file import COMPONENTS, read_smplx
from soar.config import settings
from soar.datasets.recordings import ImageFolder
from soar.errors import InputError, ModelFileError
from soar.importers import pose_network
from soar.importers.archive import Known
from soar.importers.registry import FORMATS, read_parameters
from soar.models import records
from soar.models.identify import FOLDER, Form, network, networks, overrides, ports
from soar.networks import normal_inputs, prior_inputs
from soar.perception import (
    icon,
    icon_export,
    mask_files,
    matting,
    normal_folder,
    openpose_json,
    sam,
    sapiens,
    simcc,
    yolox,
)
from soar.perception.brought import Axes, BroughtNetwork
from soar.priors.imagedream.checkpoint import Checkpoint
from soar.priors.imagedream.onnx import TOKENS, signatures
from soar.workflow import CONF

_SIZE = (1920, 1080)  # of the pictures, where a reader of parameters must be told; says nothing of whether it can read


class _Unopened(BroughtNetwork):
    """What a network takes and gives, from its file alone."""

    def __init__(self, path: Path) -> None:
        self.path, self.ports = path, ports(path)
        sides = (self.ports.inputs, self.ports.outputs)
        self.inputs, self.outputs = ({port.name: _axes(port.shape) for port in side} for side in sides)

    @property
    def signature(self) -> str:
        takes, gives = (", ".join(map(str, side)) for side in (self.ports.inputs, self.ports.outputs))
        return f"takes {takes}; gives {gives}"


def _axes(shape: tuple[int | str | None, ...] | None) -> Axes:
    return tuple(axis if isinstance(axis, int) else None for axis in shape or ())


# keypoints


def _whole_body(path: Path) -> str:
    _, height, width = simcc.layout(_Unopened(path))
    return f"crops of {width} x {height} pixels"


def _people_finder(path: Path) -> str:
    _, _, (height, width) = yolox.layout(_Unopened(path))
    return f"pictures of {width} x {height} pixels"


def _openpose(path: Path) -> str:
    files = openpose_json.read_folder(path)
    people = [len(openpose_json.read_people(file)) for file in files.values()]
    return f"{len(files)} frames, numbered {min(files)} to {max(files)}, with up to {max(people)} people"


# masks


def _described(path: Path) -> Form:
    """A network that a file of ``conf/masks`` describes by how it differs from ``network.yaml``."""

    def check(file: Path) -> str:
        node = OmegaConf.to_container(OmegaConf.merge(*map(OmegaConf.load, (path.with_name("network.yaml"), path))))
        described = settings(matting.NetworkSettings, {key: node[key] for key in node if key != "defaults"}, "masks")
        found = _Unopened(file)
        _, output = matting.matched(described, found)
        axes = found.outputs[output]
        # The stage takes any number of channels; known networks have those that are described and no more.
        channels = max(described.channels) + 1
        if len(axes) == 4 and axes[1 if described.layout == "nchw" else 3] not in (None, channels):
            raise found.misfit(f"an output {output} of {channels} channels")
        return ""

    use = overrides(f"masks={path.stem}", "masks.network=PATH")
    return Form(f"mask network of the kind {path.stem}", use, (".onnx",), check)


def _mask_networks() -> list[Form]:
    files = sorted((CONF / "masks").glob("*.yaml"))
    return [_described(path) for path in files if "\n  - network\n" in path.read_text("utf-8")]


_FEATURES: dict[str, Axes] = {
    "image_embeddings": (1, 256, 64, 64), "image_embed": (1, 256, 64, 64),
    "high_res_feats_0": (1, 32, 256, 256), "high_res_feats_1": (1, 64, 128, 128),
    "image_features_0": (1, 32, 256, 256), "image_features_1": (1, 64, 128, 128),
}  # fmt: skip

"""What encoders of Segment Anything give, by name."""


def _sam(scheme: sam.Scheme) -> list[Form]:
    """Encoder and decoder of a family, each by itself."""

    def encoder(path: Path) -> str:
        network, taken = _Unopened(path), {name: _FEATURES[name] for name in scheme.features}
        if not sam.is_encoder(scheme, network, SimpleNamespace(inputs=taken)):
            raise network.misfit(f"a picture; gives {', '.join(f'{name} {axes}' for name, axes in taken.items())}")
        return ""

    def decoder(path: Path) -> str:
        network = _Unopened(path)
        if not sam.is_decoder(scheme, network):
            raise network.misfit(f"{', '.join(sorted(scheme.inputs))}, {scheme.size}; gives masks, iou_predictions")
        return ""

    option = "sam2" if scheme.stretched else "sam"
    return [
        Form(f"encoder of {scheme.name}", overrides(f"masks={option}", "masks.encoder=PATH", "masks.decoder=..."),
             (".onnx",), encoder),
        Form(f"decoder of {scheme.name}", overrides(f"masks={option}", "masks.encoder=...", "masks.decoder=PATH"),
             (".onnx",), decoder),
    ]  # fmt: skip


def _masks(path: Path) -> str:
    """A folder of masks: numbered pictures that are grey, or have an alpha channel."""
    pictures = ImageFolder(path)
    first = mask_files.read_picture(pictures.files()[0])
    channels = 1 if first.ndim == 2 else first.shape[2]
    if channels == 3 and np.ptp(first.astype(int), axis=-1).max() > mask_files._NEUTRAL:
        raise InputError(f"{path} holds pictures with colours", expected="masks: grey, or with an alpha channel")
    numbers = pictures.probe.numbers or ()
    where = "in the alpha channel: add masks.plane=alpha" if channels == 4 else "white where the person is"
    return f"{len(numbers)} masks, numbered {numbers[0]} to {numbers[-1]}, {where}"


# bodies


def _smplx(path: Path) -> str:
    file = read_smplx(path)
    version = "1.1" if file.shapedirs.shape[2] == COMPONENTS[400] else "1.0"
    return f"version {version}, {file.shapedirs.shape[2]} shape components"


_SINGLE = {"romp": (".npz",), "phalp": (".pkl",), "wham": (".pkl",), "gvhmr": (".pt",), "params": (".pth",)}
"""Suffixes of the formats that are single files, too."""


def _parameters(kind: str) -> Form:
    def check(path: Path) -> str:
        found = read_parameters(kind, path, Known(_SIZE, None, None))
        frames = sorted({int(frame) for person in found.people for frame in person.frames})
        return f"{len(found.people)} people in frames {frames[0]} to {frames[-1]}"

    use = overrides(
        "body_model=smplx", "body_model.source=...", "body=imported", f"body.format={kind}", "body.source=PATH"
    )
    return Form(f"body parameters of {kind}", use, (FOLDER, *_SINGLE.get(kind, ())), check)


# checkpoints, and what comes with the project


def _icon_checkpoint(path: Path) -> str:
    weights = icon_export.read_checkpoint(path)
    for name in icon.SIGNATURES:
        icon_export.matched(path, name, weights)
    return f"with {', '.join(f'netG.{name}' for name in icon.SIGNATURES)}"


def _imagedream(path: Path) -> str:
    return f"{len(Checkpoint(path).tensors)} tensors"


def _installed(path: Path) -> str:
    for folder in (path.parent, path.parent.parent):
        file = str(path.relative_to(folder))
        if record := records.read(folder, file):
            records.check(folder, file)
            return f"sha256 {record['sha256'][:12]}, as recorded"
    raise ModelFileError(f"{path} is no installed model file", expected=f"a record of it in {path.parent / 'records'}")


_WEIGHTS = (".ckpt", ".pt", ".pth")

FORMS: tuple[Form, ...] = (
    Form("whole-body network with SimCC heads, as RTMW, RTMPose and DWPose",
         overrides("keypoints=rtmw", "keypoints.network=PATH"), (".onnx",), _whole_body),
    Form("YOLOX, which finds people",
         overrides("keypoints=rtmw", "keypoints.network=...", "keypoints.detector=PATH"), (".onnx",), _people_finder),
    Form("keypoints of OpenPose", overrides("keypoints=openpose", "keypoints.source=PATH"), (FOLDER,), _openpose),
    network("normal network of the bundled kind", overrides("normals.network=PATH"), normal_inputs.SIGNATURE),
    network("normal network of Sapiens", overrides("normals=sapiens", "normals.network=PATH"), sapiens.SIGNATURE),
    networks(
        "normal networks of ICON or ECON", overrides("normals=icon", "normals.network=PATH"), icon.SIGNATURES
    ),
    Form("checkpoint of the normal networks of ICON or ECON",
         "python -m soar export-normals PATH data/networks/icon", _WEIGHTS, _icon_checkpoint),
    Form("normal maps", overrides("normals=files", "normals.source=PATH"), (FOLDER,),
         lambda path: normal_folder.find(path).describe()),
    *_mask_networks(),
    *(form for scheme in sam.SCHEMES for form in _sam(scheme)),
    Form("masks", overrides("masks=files", "masks.source=PATH"), (FOLDER,), _masks),
    Form("model file of SMPL-X", overrides("body_model=smplx", "body_model.source=PATH"), (".npz", ".pkl"), _smplx),
    network(
        "network that estimates SMPL-X's parameters",
        overrides("body_model=smplx", "body_model.source=...", "body=regressor", "body.network=PATH"),
        pose_network.SIGNATURE,
    ),
    *map(_parameters, FORMATS),
    network("prior of the bundled kind", overrides("prior.network=PATH"), prior_inputs.signature(64)),
    *(
        networks(
            f"prior ImageDream, exported in the mode {mode}",
            overrides("prior=onnx", f"prior.mode={mode}", "prior.source=PATH"), signatures(mode), (TOKENS,),
        )
        for mode in ("pixel", "local")
    ),
    Form("checkpoint of ImageDream", overrides("prior=imagedream", "prior.source=PATH"), _WEIGHTS, _imagedream),
    Form("model file of the project's own, which needs no setting", "python -m soar models",
         (".onnx", ".safetensors", ".npz", ".gz"), _installed),
)  # fmt: skip
