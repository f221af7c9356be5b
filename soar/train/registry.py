"""The trainings there are, by the name of their file in ``conf/train``."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from soar.config import settings
from soar.train.loop import LoopSettings, Training
from soar.train.normals import NormalTask
from soar.train.prior import PriorTask
from soar.train.task import Task

TASKS: dict[str, type] = {"normals": NormalTask, "prior": PriorTask}


def training(name: str, node: Mapping[str, Any], models: Path, folder: Path) -> Training:
    """The training ``name`` in ``folder``, new or where it was.

    Args:
        name: a key of :data:`TASKS`.
        node: the configuration node ``train``: settings of the loop, and the task's own.
        models: folder of the model files.
        folder: where state, curves and the finished network go.

    Raises:
        ConfigError: an unknown or ill-typed setting, or a folder with another training.
    """
    loop = {field.name for field in dataclasses.fields(LoopSettings)} & set(node)
    options = settings(LoopSettings, {key: node[key] for key in loop}, "train")
    return Training(task(name, node, models), options, {"task": name, **node}, folder)


def task(name: str, node: Mapping[str, Any], models: Path) -> Task:
    """What is trained; arguments as :func:`training`."""
    loop = {field.name for field in dataclasses.fields(LoopSettings)}
    return TASKS[name]({key: value for key, value in node.items() if key not in loop}, models)
