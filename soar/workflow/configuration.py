"""Configuration of a variant, as Hydra composes it."""

from __future__ import annotations

import functools
import json
import re
from collections.abc import Iterable, Mapping
from typing import Any

from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.errors import HydraException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from soar.errors import ConfigError
from soar.workflow.table import CONF


def canonical(value: Any) -> str:
    """Canonical JSON: equal values give equal text."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"))


def _quote(value: Any) -> str:
    """A value in Hydra's override grammar."""
    if value is None or isinstance(value, (bool, int, float)):
        return json.dumps(value)
    if isinstance(value, Mapping):
        return "{" + ",".join(f"{k}:{_quote(v)}" for k, v in value.items()) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ",".join(map(_quote, value)) + "]"
    text = str(value)
    # Snakemake hands YAML scalars over as text; a bare word lets Hydra read true, null and numbers as such.
    if re.fullmatch(r"[\w./:+-]+( [\w./:+-]+)*", text) and not text.endswith(":") and ":" not in text:
        return text
    return "'" + text.replace("\\", "\\\\").replace("'", "\\'") + "'"


def overrides_from(config: Mapping[str, Any]) -> tuple[str, ...]:
    """Hydra overrides for what Snakemake's ``--config`` or ``--configfile`` gave.

    ``dataset=video`` chooses a group's option; ``reconstruct={steps: 100}`` sets fields; ``overrides=["a.b=1"]``
    passes overrides as they are. ``variants`` and ``sequences`` are lists of names.
    """
    result: list[str] = []
    for key, value in config.items():
        if key == "overrides":
            result += [value] if isinstance(value, str) else list(map(str, value))
        elif (CONF / key).is_dir() and not isinstance(value, Mapping):
            result.append(f"{key}={value}")
        elif isinstance(value, Mapping):
            result += _flatten(key, value)
        else:
            result.append(f"{key}={_quote(value)}")
    # A group must be chosen before its fields are set.
    return tuple(sorted(result, key=lambda o: "." in o.split("=", 1)[0]))


def _flatten(prefix: str, node: Mapping[str, Any]) -> Iterable[str]:
    for key, value in node.items():
        if isinstance(value, Mapping):
            yield from _flatten(f"{prefix}.{key}", value)
        else:
            yield f"{prefix}.{key}={_quote(value)}"


@functools.cache
def composed(overrides: tuple[str, ...]) -> dict[str, Any]:
    """The configuration as plain, resolved containers.

    Raises:
        ConfigError: for an unknown key, group or option, or a malformed override.
    """
    GlobalHydra.instance().clear()
    try:
        with initialize_config_dir(str(CONF), version_base="1.3"):
            return OmegaConf.to_container(compose("config", list(overrides)), resolve=True, throw_on_missing=True)  # type: ignore[return-value]
    except (HydraException, OmegaConfBaseException) as error:
        raise ConfigError(
            "the configuration cannot be composed",
            got=str(error).strip(),
            cure="see conf/README.md for keys and options",
        ) from error


def variant_names() -> list[str]:
    """All variants in ``conf/variant``; ``full`` is the one the others share with where they can."""
    names = sorted(path.stem for path in (CONF / "variant").glob("*.yaml"))
    return ["full", *(name for name in names if name != "full")]
