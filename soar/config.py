"""From a resolved configuration node to a typed settings object.

Settings are frozen dataclasses without defaults, declared next to the code that reads them; every value lives in
``conf/``. An unknown, missing or ill-typed key is a :class:`~soar.errors.ConfigError`.
"""

from __future__ import annotations

import dataclasses
import types
import typing
from collections.abc import Mapping
from typing import Any, TypeVar

from soar.errors import ConfigError

T = TypeVar("T")


def settings(cls: type[T], node: Mapping[str, Any], where: str = "") -> T:
    """Build the settings dataclass ``cls`` from a plain mapping.

    Args:
        cls: a dataclass; fields may be nested dataclasses, ``X | None``, ``tuple[X, ...]``, ``dict`` or scalars.
        node: the mapping, as ``OmegaConf.to_container(..., resolve=True)`` gives it.
        where: dotted path of the node, for messages.

    Raises:
        ConfigError: for an unknown or missing key or a value of another type.
    """
    where = where or cls.__name__
    if not isinstance(node, Mapping):
        raise ConfigError(f"configuration node {where} is not a mapping", expected="keys", got=repr(node))
    fields = {f.name: f for f in dataclasses.fields(cls)}  # type: ignore[arg-type]
    unknown, missing = sorted(set(node) - set(fields)), sorted(set(fields) - set(node))
    if unknown or missing:
        raise ConfigError(
            f"configuration node {where} does not fit its schema",
            expected=", ".join(fields),
            got=", ".join([*(f"unknown {k}" for k in unknown), *(f"missing {k}" for k in missing)]),
            cure="correct the key in conf/ or in the override",
        )
    hints = typing.get_type_hints(cls)
    return cls(**{name: _convert(node[name], hints[name], f"{where}.{name}") for name in fields})


def _convert(value: Any, hint: Any, where: str) -> Any:
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if hint is Any:
        return value
    if origin in (typing.Union, types.UnionType):
        if value is None and type(None) in args:
            return None
        errors: list[ConfigError] = []
        for option in (a for a in args if a is not type(None)):
            try:
                return _convert(value, option, where)
            except ConfigError as error:
                errors.append(error)
        raise errors[0]
    if origin is typing.Literal:
        if value in args:
            return value
        raise _mismatch(where, "one of " + ", ".join(map(repr, args)), value)
    if dataclasses.is_dataclass(hint):
        return settings(hint, value, where)  # type: ignore[arg-type]
    if origin is tuple:
        if not isinstance(value, (list, tuple)):
            raise _mismatch(where, "a list", value)
        if len(args) == 2 and args[1] is Ellipsis:
            return tuple(_convert(v, args[0], f"{where}[{i}]") for i, v in enumerate(value))
        if len(args) != len(value):
            raise _mismatch(where, f"a list of {len(args)}", value)
        return tuple(_convert(v, a, f"{where}[{i}]") for i, (v, a) in enumerate(zip(value, args, strict=True)))
    if origin is dict or hint is dict:
        if not isinstance(value, Mapping):
            raise _mismatch(where, "a mapping", value)
        if not args:
            return dict(value)
        return {str(k): _convert(v, args[1], f"{where}.{k}") for k, v in value.items()}
    if hint is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if (hint is not bool and isinstance(value, bool)) or not isinstance(value, hint):
        raise _mismatch(where, hint.__name__, value)
    return value


def _mismatch(where: str, expected: str, value: Any) -> ConfigError:
    return ConfigError(f"configuration value {where} has the wrong type", expected=expected, got=repr(value))
