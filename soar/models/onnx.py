"""Sessions of ONNX networks."""

from __future__ import annotations

import os
from pathlib import Path

import onnxruntime as ort
from onnxruntime.capi import onnxruntime_pybind11_state as state

from soar.errors import ModelFileError
from soar.models import records

_UNREADABLE = (state.InvalidProtobuf, state.InvalidGraph, state.InvalidArgument, state.Fail, state.NotImplemented)


def session(path: str | os.PathLike[str], threads: int) -> ort.InferenceSession:
    """Open an ONNX file for inference on the processor.

    Args:
        path: the file; one that we installed is checked against its recorded sha256.
        threads: threads of one inference.

    Raises:
        ModelFileError: the file is missing, altered, truncated, or no ONNX network.
    """
    path = Path(path)
    if not path.is_file():
        raise ModelFileError(
            f"{path} is missing", cure="run `python -m soar models fetch`, or name a file that is there"
        )
    records.check(path.parent, path.name)
    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    # Several jobs share the machine: threads that spin while waiting would slow each other down.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    try:
        return ort.InferenceSession(path.read_bytes(), options, providers=["CPUExecutionProvider"])
    except _UNREADABLE as error:
        raise ModelFileError(
            f"{path} is not a usable ONNX network: {error}",
            cure="delete the file and run `python -m soar models fetch`",
        ) from error
