"""Qualisys Track Manager calibration (``.qca.txt``, XML) in the form of ``docs/data.md``."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from soar.errors import CalibrationError

_SUBPIXELS = 64.0  # the file counts 1/64 pixels


def read_qualisys(path: Path) -> dict[str, Any]:
    """Translate a Qualisys calibration.

    Qualisys stores millimetres, 1/64 pixels, and the camera's axes (x right, y up, z backward) as the rows of a
    rotation; the world is z-up. OpenCV's camera turns the last two axes round: ``R = diag(1, -1, -1) M``,
    ``t = -R C``.

    Raises:
        CalibrationError: the file is missing, not such XML, declares entities, or lacks a value.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise CalibrationError(f"{path} does not exist", cure="run `python -m soar fetch`") from error
    except UnicodeDecodeError as error:
        raise CalibrationError(f"{path} is not text: {error}") from error
    # A document type can declare entities that expand without bound; a calibration has no need of one.
    if re.search(r"<!\s*(DOCTYPE|ENTITY)", text, re.IGNORECASE):
        raise CalibrationError(f"{path} declares a document type or entities", cure="remove the declaration")
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise CalibrationError(f"{path} is not XML: {error}") from error
    entries = root.findall("./cameras/camera")
    if not entries:
        raise CalibrationError(f"{path} holds no camera", expected="<calibration><cameras><camera serial=...>")
    cameras = {_serial(entry, path): _camera(entry, path) for entry in entries}
    if len(cameras) < len(entries):
        raise CalibrationError(f"{path} names a camera twice", got=", ".join(_serial(entry, path) for entry in entries))
    return {"units": "metres", "up": [0.0, 0.0, 1.0], "cameras": cameras}


def _serial(entry: ElementTree.Element, path: Path) -> str:
    if not (serial := entry.get("serial")):
        raise CalibrationError(f"{path}: a camera has no serial")
    return serial


def _camera(entry: ElementTree.Element, path: Path) -> dict[str, Any]:
    where = f"{path}: camera {_serial(entry, path)}"
    video = _values(entry, "fov_video", where, "left", "top", "right", "bottom")
    fx, fy, cx, cy = _values(entry, "intrinsic", where, "focalLengthU", "focalLengthV", "centerPointU", "centerPointV")
    k1, k2, k3 = _values(entry, "intrinsic", where, *(f"radialDistortion{i}" for i in (1, 2, 3)))
    p1, p2 = _values(entry, "intrinsic", where, *(f"tangentalDistortion{i}" for i in (1, 2)))
    rotation = _values(entry, "transform", where, *(f"r{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3)))
    R = np.diag([1.0, -1.0, -1.0]) @ np.reshape(rotation, (3, 3))
    centre = np.array(_values(entry, "transform", where, "x", "y", "z")) / 1000.0
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = R, -R @ centre
    return {
        "size": [int(video[2] - video[0]) + 1, int(video[3] - video[1]) + 1],
        "K": [value / _SUBPIXELS for value in (fx, fy, cx, cy)],
        "distortion": [k1, k2, p1, p2, k3],
        "T_cam_from_world": transform.tolist(),
    }


def _values(entry: ElementTree.Element, tag: str, where: str, *names: str) -> list[float]:
    element = entry.find(tag)
    if element is None:
        raise CalibrationError(f"{where} has no <{tag}>")
    try:
        return [float(element.attrib[name]) for name in names]
    except (KeyError, ValueError) as error:
        raise CalibrationError(f"{where}: <{tag}> lacks or malforms {error}") from error
