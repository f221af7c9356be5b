"""From a checkpoint to the ONNX files of the contract in docs/priors.md, each compared with the network it was made of.

Weights are kept beside every graph in one file: a protocol buffer holds at most 2 GB. They are written one by one, so
that an export needs the memory of its largest network once, and again while it is compared.
"""

from __future__ import annotations

import gc
import io
import os
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Protocol

import numpy as np
import onnx
import torch
from onnx import TensorProto
from torch import Tensor, nn

from soar.artifacts import atomic_path
from soar.errors import ModelFileError
from soar.models.onnx import Signature, session
from soar.priors.imagedream.checkpoint import Checkpoint
from soar.priors.imagedream.networks import TorchNetworks
from soar.priors.imagedream.onnx import TOKENS, signatures
from soar.priors.imagedream.prior import FRAMES, VOCABULARY
from soar.priors.imagedream.schedule import STEPS
from soar.priors.imagedream.tokens import tokenizer

OPSET = 17
TOLERANCE = 1e-3  # largest difference between a file and its network, as a share of the largest output


class Method(nn.Module):
    """One method of a module, as a module of its own."""

    def __init__(self, owner: nn.Module, name: str) -> None:
        super().__init__()
        self.owner, self.name = owner, name

    def forward(self, *inputs: Tensor) -> Tensor:
        return getattr(self.owner, self.name)(*inputs)


class Exportable(Protocol):
    """Networks to export, see :class:`soar.priors.imagedream.networks.TorchNetworks`."""

    frames: int

    @property
    def unet(self) -> nn.Module: ...

    @property
    def autoencoder(self) -> nn.Module: ...

    def text_tower(self) -> nn.Module: ...

    def image_tower(self) -> nn.Module: ...


def export_checkpoint(checkpoint: Path, folder: Path, mode: str, models: Path, threads: int) -> None:
    """Write the five networks and the tokeniser of a checkpoint to ``folder``.

    Args:
        checkpoint: the released file.
        folder: for the files; about 8 GB.
        mode: ``pixel`` or ``local``.
        models: folder of the model files, with the vocabulary.
        threads: of the comparisons.

    Raises:
        ModelFileError: the checkpoint is not the right one, or a file does not compute what its network does.
        StorageError: the disk is full or not writable.
    """
    networks = TorchNetworks(Checkpoint(checkpoint), FRAMES[mode], torch.device("cpu"))
    with atomic_path(folder / TOKENS) as temporary:
        tokenizer(models / VOCABULARY).save(str(temporary))
    export_networks(networks, signatures(mode), folder, threads)


def export_networks(networks: Exportable, contract: Mapping[str, Signature], folder: Path, threads: int) -> None:
    """Write five files, one after the other; see :func:`write`.

    Args:
        networks: what they compute.
        contract: their names and shapes.
        folder: for the files.
        threads: of the comparisons.
    """
    makers: dict[str, Callable[[], nn.Module]] = {
        "text_encoder": networks.text_tower,
        "image_encoder": networks.image_tower,
        "vae_encoder": lambda: Method(networks.autoencoder, "encode"),
        "vae_decoder": lambda: Method(networks.autoencoder, "decode"),
        "unet": lambda: networks.unet,
    }
    for name, make in makers.items():
        write(make(), contract[name], networks.frames if name == "unet" else 1, folder / f"{name}.onnx", threads)
        gc.collect()


def write(network: nn.Module, signature: Signature, views: int, path: Path, threads: int) -> float:
    """Write one network to ``path`` and its weights to ``path`` with ``.data`` appended.

    Args:
        network: takes the tensors of ``signature.inputs`` in order and returns the one of the outputs.
        signature: names and shapes.
        views: rows of a batch that belong together; ``ip_img`` has one row for so many.
        path: the ``.onnx`` file.
        threads: of the comparison.

    Returns:
        the largest difference found, as a share of the largest output.

    Raises:
        ModelFileError: it is more than 0.1 %.
    """
    buffer = io.BytesIO()
    with warnings.catch_warnings(), torch.no_grad():
        # The exporter warns that it is the older one, and where it takes a size for a constant, which it is.
        warnings.simplefilter("ignore")
        torch.onnx.export(
            network,
            tuple(_noise(signature, 1, views)),
            buffer,
            opset_version=OPSET,
            dynamo=False,
            export_params=False,
            do_constant_folding=False,
            input_names=list(signature.inputs),
            output_names=list(signature.outputs),
            dynamic_axes={name: {0: "batch"} for name in (*signature.inputs, *signature.outputs)},
        )
    graph = onnx.load_from_string(buffer.getvalue())
    for value in graph.graph.output:
        # The exporter does not always work them out.
        for axis, length in zip(value.type.tensor_type.shape.dim, signature.outputs[value.name], strict=True):
            if length is not None:
                axis.dim_value = length
    data = path.with_name(path.name + ".data")
    with atomic_path(data) as temporary:
        _attach(graph, {**dict(network.named_parameters()), **dict(network.named_buffers())}, temporary, data.name)
    with atomic_path(path) as temporary:
        temporary.write_bytes(graph.SerializeToString())
    worst = difference(network, signature, views, path, threads)
    if not worst <= TOLERANCE:  # NaN is no agreement
        path.unlink()
        raise ModelFileError(
            f"{path} would not compute what the network does",
            expected=f"outputs equal to {TOLERANCE:g} of the largest",
            got=f"a difference of {worst:.2g}",
            cure="report this with the versions of torch, onnx and onnxruntime",
        )
    return worst


def difference(network: nn.Module, signature: Signature, views: int, path: Path, threads: int) -> float:
    """Largest difference between file and network on noise, over the largest output, for one object and for two."""
    opened = session(path, threads, signature)
    shares = []
    for count in (1, 2):
        inputs = _noise(signature, count, views)
        with torch.no_grad():
            expected = network(*inputs).numpy()
        feed = {name: value.numpy() for name, value in zip(signature.inputs, inputs, strict=True)}
        (got,) = opened.run(list(signature.outputs), feed)
        shares.append(np.abs(got - expected).max() / np.abs(expected).max())
    return float(np.max(shares))


def _attach(graph: onnx.ModelProto, weights: Mapping[str, Tensor], data: Path, location: str) -> None:
    """Write the weights that the graph asks for to ``data``, and name them there instead."""
    names = {value.name for value in graph.graph.input} & weights.keys()
    kept = [value for value in graph.graph.input if value.name not in names]
    del graph.graph.input[:]
    graph.graph.input.extend(kept)
    with data.open("wb") as stream:
        for name in sorted(names):
            array = np.ascontiguousarray(weights[name].detach().cpu().numpy())
            tensor = TensorProto(
                name=name,
                dims=array.shape,
                data_type=onnx.helper.np_dtype_to_tensor_dtype(array.dtype),
                data_location=TensorProto.EXTERNAL,
            )
            stream.seek(-stream.tell() % 4096, os.SEEK_CUR)  # pages, so that files can be mapped
            for key, value in (("location", location), ("offset", stream.tell()), ("length", array.nbytes)):
                tensor.external_data.add(key=key, value=str(value))
            stream.write(array.tobytes())
            graph.graph.initializer.append(tensor)


def _noise(signature: Signature, objects: int, views: int) -> list[Tensor]:
    """Normal noise; whole numbers are steps or tokens."""
    generator = torch.Generator().manual_seed(objects)
    drawn = []
    for name, shape in signature.inputs.items():
        size = (objects if name == "ip_img" else objects * views, *shape[1:])
        if name in signature.integers:
            drawn.append(torch.randint(0, STEPS, size, generator=generator))
        else:
            drawn.append(torch.randn(size, generator=generator))
    return drawn
