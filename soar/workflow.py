"""What the Snakefile needs to know: stages, their files, configuration and code, and which variants share work.

Hydra composes the configuration once per variant when the Snakefile is parsed. A stage declares here the files it
reads and writes and the configuration nodes it sees; a job receives exactly those nodes as one canonical JSON string.
Two variants whose configuration and code agree for a stage *and all stages above it* share its artifacts; the sharing
is computed from this table, never listed by hand.

This module is imported at every parse and imports no numerical library.
"""

from __future__ import annotations

import ast
import dataclasses
import functools
import hashlib
import json
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.errors import HydraException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from soar.errors import ConfigError

ROOT = Path(__file__).resolve().parent.parent
CONF = ROOT / "conf"

MODELS = "data/models"


@dataclasses.dataclass(frozen=True)
class Stage:
    """One stage of the DAG.

    Attributes:
        name: rule, module in ``soar/stages`` and folder of the artifacts.
        config: configuration nodes the stage sees.
        reads: input name -> ``stage/file`` of the same sequence. ``{camera}`` is the job's own camera in a per-camera
            stage; a sequence-level stage reads the file of every camera. ``=path`` is a path as it stands.
        writes: output name -> file below the stage's folder; with ``{camera}`` in a per-camera stage.
        per_camera: one job per camera instead of one per sequence.
        cameras: which cameras a per-camera stage runs for: ``all`` or ``train``.
        evidence: whether the stage leaves a picture and health numbers.
        given: what the stage reads besides where its ``provider`` is ``dataset``: what the dataset knows already.
    """

    name: str
    config: tuple[str, ...]
    reads: Mapping[str, str]
    writes: Mapping[str, str]
    cameras: str = "all"
    per_camera: bool = False
    evidence: bool = True
    given: Mapping[str, str] = dataclasses.field(default_factory=dict)

    @property
    def files(self) -> dict[str, str]:
        """All outputs, with the evidence and the provenance record that every stage leaves."""
        prefix = "{camera}." if self.per_camera else ""
        extra = {"health": f"{prefix}health.json", "evidence": f"{prefix}evidence.jpg"} if self.evidence else {}
        return {**self.writes, **extra, "provenance": f"{prefix}provenance.json"}


_MODELS = {"models": f"={MODELS}/manifest.json"}
_BODY_MODEL = {"body_model": f"={MODELS}/body/anny.npz"}
_SEQUENCE = {"sequence": "ingest/sequence.json"}
_FRAMES = {"frames": "frames/{camera}.zip"}
_MASKS = {"masks": "masks/{camera}.zip"}
_KEYPOINTS = {"keypoints": "keypoints/{camera}.npz"}
_CALIBRATION = {"calibration": "calibrate/calibration.json"}
_CAMERAS = {"calibration": "body/cameras.json"}
_POSED = {**_SEQUENCE, **_BODY_MODEL, "body": "body/body.npz", "crops": "crops/{camera}.npz"}

STAGES: dict[str, Stage] = {
    stage.name: stage
    for stage in (
        Stage("ingest", ("dataset",), {}, {"sequence": "sequence.json"}, evidence=False),
        Stage("frames", ("dataset",), _SEQUENCE, {"frames": "{camera}.zip"}, per_camera=True),
        Stage("truth", ("dataset",), _SEQUENCE | _BODY_MODEL, {"body": "body.npz", "surface": "surface.npz"}),
        Stage("maps", ("dataset",), _SEQUENCE, {"maps": "{camera}.zip"}, per_camera=True),
        Stage(
            "keypoints",
            ("keypoints",),
            _SEQUENCE | _FRAMES | _MODELS,
            {"keypoints": "{camera}.npz"},
            per_camera=True,
            given=_BODY_MODEL | {"given": "truth/body.npz"},
        ),
        Stage(
            "masks",
            ("masks",),
            _SEQUENCE | _FRAMES | _KEYPOINTS | _MODELS,
            {"masks": "{camera}.zip"},
            per_camera=True,
            given={"given": "maps/{camera}.zip"},
        ),
        Stage("calibrate", ("calibrate",), _SEQUENCE | _FRAMES | _KEYPOINTS, {"calibration": "calibration.json"}),
        Stage(
            "body",
            ("body", "monocular"),
            _SEQUENCE | _CALIBRATION | _FRAMES | _KEYPOINTS | _MASKS | _BODY_MODEL,
            {"body": "body.npz", "cameras": "cameras.json"},
            given={"given": "truth/body.npz"},
        ),
        Stage(
            "monocular",
            ("body", "monocular"),
            _SEQUENCE | _CAMERAS | _FRAMES | _KEYPOINTS | _MASKS | _BODY_MODEL | {"reference": "body/body.npz"},
            {"body": "body.npz"},
        ),
        Stage(
            "crops",
            ("crops",),
            _SEQUENCE | _CAMERAS | _FRAMES | _MASKS,
            {"crops": "{camera}.npz"},
            per_camera=True,
        ),
        Stage(
            "normals",
            ("normals", "raster"),
            _POSED,
            {"normals": "{camera}.npz"},
            per_camera=True,
            cameras="train",
            given={"given": "maps/{camera}.zip"},
        ),
        Stage("caption", ("caption", "raster"), _POSED, {"caption": "caption.json"}),
        Stage("paint", ("avatar", "paint", "raster"), _POSED, {"avatar": "avatar.safetensors"}),
        Stage(
            "reconstruct",
            ("avatar", "reconstruct", "raster"),
            _POSED | _MODELS | {"normals": "normals/{camera}.npz", "paint": "paint/avatar.safetensors"},
            {"avatar": "avatar.safetensors", "curves": "curves.json"},
        ),
        Stage(
            "occlusion",
            ("occlusion", "raster"),
            _POSED | {"avatar": "reconstruct/avatar.safetensors"},
            {"avatar": "avatar.safetensors", "occlusion": "occlusion.json"},
        ),
        Stage(
            "refine",
            ("avatar", "reconstruct", "refine", "prior", "raster"),
            _POSED
            | _MODELS
            | {
                "normals": "normals/{camera}.npz",
                "avatar": "occlusion/avatar.safetensors",
                "caption": "caption/caption.json",
            },
            {"avatar": "avatar.safetensors", "curves": "curves.json"},
        ),
        Stage(
            "render",
            ("render", "raster"),
            _POSED | {"avatar": "refine/avatar.safetensors"},
            {"turntable": "turntable.webm"},
        ),
        Stage(
            "views",
            ("render", "raster"),
            _POSED | {"avatar": "refine/avatar.safetensors"},
            {"view": "{camera}.webm"},
            per_camera=True,
            evidence=False,
        ),
        Stage(
            "evaluate",
            ("evaluate", "raster"),
            _POSED
            | _MODELS
            | {
                "avatar": "refine/avatar.safetensors",
                "unrefined": "occlusion/avatar.safetensors",
                "paint": "paint/avatar.safetensors",
            },
            {"metrics": "metrics.json", "table": "per_frame.csv", "sheet": "comparison.jpg"},
        ),
    )
}

SETUP = ("fetch", "models")
"""Set-up stages: they fill ``data/`` and know no sequence."""


def canonical(value: Any) -> str:
    """Canonical JSON: equal values give equal text."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"))


# --- code fingerprints -----------------------------------------------------------------------------------------------


def _strip_docstrings(tree: ast.Module) -> ast.Module:
    for node in ast.walk(tree):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
            body = node.body
            first = body[0] if body else None
            if (
                isinstance(first, ast.Expr)
                and isinstance(first.value, ast.Constant)
                and isinstance(first.value.value, str)
            ):
                node.body = body[1:] or [ast.Pass()]
    return tree


def _imports(tree: ast.Module, package: str) -> set[str]:
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parent = package.split(".")[: len(package.split(".")) - node.level + 1]
                base = ".".join([*parent, base]) if base else ".".join(parent)
            found.update([base, *(f"{base}.{alias.name}" for alias in node.names)])
    return {name for name in found if name.split(".")[0] == "soar"}


@functools.cache
def _module(name: str) -> tuple[str, frozenset[str]] | None:
    """Meaning (code without comments and docstrings) and soar imports of a module; None if there is none."""
    base = ROOT.joinpath(*name.split("."))
    path = base / "__init__.py" if base.is_dir() else base.with_suffix(".py")
    if not path.is_file():
        return None
    tree = ast.parse(path.read_text(encoding="utf-8"))
    package = name if base.is_dir() else name.rpartition(".")[0]
    imports = frozenset(_imports(tree, package))
    text = ast.unparse(_strip_docstrings(tree))
    for source in sorted((path.parent / "native").glob("*.[ch]*")):
        text += re.sub(r"/\*.*?\*/|//[^\n]*|\s+", " ", source.read_text(encoding="utf-8"), flags=re.S)
    # Data of the package, and the template of the same name beside a module.
    for data in (*sorted((path.parent / "data").rglob("*.json")), *path.parent.glob(f"{path.stem}.html")):
        text += hashlib.sha256(data.read_bytes()).hexdigest()
    return text, imports


def fingerprint(stage: str, cfg: Mapping[str, Any]) -> str:
    """Hash of the code a stage runs: its module and everything of soar that it imports, directly or not.

    Of the dataset adapters only the one that ``cfg``, the stage's configuration, names counts. Comments, docstrings and
    layout do not count. Native sources and package data beside an imported module do.
    """
    from soar.datasets import adapter_module

    adapters = (adapter_module(cfg["dataset"]),) if "dataset" in cfg else ()
    return _fingerprint(f"soar.stages.{stage}", *adapters)


@functools.cache
def _fingerprint(*modules: str) -> str:
    pending, seen = [*modules], {}
    while pending:
        name = pending.pop()
        if name in seen:
            continue
        module = _module(name)
        seen[name] = module[0] if module else ""
        if module:
            parents = {name.rsplit(".", i)[0] for i in range(1, name.count(".") + 1)}
            pending.extend(module[1] | parents)
    meaning = canonical({name: text for name, text in seen.items() if text})
    return hashlib.sha256(meaning.encode()).hexdigest()[:16]


# --- configuration ---------------------------------------------------------------------------------------------------


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


class Workflow:
    """Paths, parameters and sharing for one set of overrides.

    Args:
        config: what Snakemake's ``--config`` gave, see :func:`overrides_from`.

    Raises:
        ConfigError: for anything unknown or malformed in it.
    """

    def __init__(self, config: Mapping[str, Any] | None = None) -> None:
        from soar.datasets import adapter

        self.overrides = overrides_from(config or {})
        base = self.config("full")
        self.dataset: str = base["dataset"]["name"]
        self.variants: list[str] = list(base["variants"])
        unknown = sorted(set(self.variants) - set(variant_names()))
        if unknown:
            raise ConfigError("unknown variant", expected=", ".join(variant_names()), got=", ".join(unknown))
        self._adapter = adapter(base["dataset"])
        self._check_providers()
        known = self._adapter.sequences()
        self.sequences: list[str] = list(base["sequences"] or known)
        if set(self.sequences) - set(known):
            raise ConfigError("unknown sequence", expected=", ".join(known), got=", ".join(self.sequences))

    def _check_providers(self) -> None:
        for variant in self.variants:
            for stage in STAGES:
                if self._is_given(stage, variant) and stage not in self._adapter.provides:
                    options = sorted(path.stem for path in (CONF / stage).glob("*.yaml"))
                    others = [option for option in options if option != "dataset"]
                    raise ConfigError(
                        f"{stage}=dataset: the dataset {self.dataset} gives no {stage}",
                        expected=f"one of {', '.join(others)}",
                        got=f"a dataset that gives {', '.join(sorted(self._adapter.provides)) or 'its footage only'}",
                        cure=f"choose {stage}={others[0]}, or a dataset that knows them, such as dataset=synthetic",
                    )

    # configuration of a stage

    def config(self, variant: str) -> dict[str, Any]:
        """The whole configuration of a variant."""
        return composed((*self.overrides, f"variant={variant}"))

    def slice(self, stage: str, variant: str) -> dict[str, Any]:
        """The nodes a stage declares, and the seed."""
        config = self.config(variant)
        return {"seed": config["seed"]} | {node: config[node] for node in STAGES[stage].config}

    @functools.cache  # noqa: B019  (a Workflow lives as long as the process)
    def _lineage(self, stage: str, variant: str) -> str:
        reads = self._reads(stage, variant).values()
        above = sorted({path.split("/")[0] for path in reads if not path.startswith("=")})
        return canonical([self.slice(stage, variant), {name: self._lineage(name, variant) for name in above}])

    @functools.cache  # noqa: B019
    def owner(self, stage: str, variant: str) -> str:
        """The variant in whose folder ``stage`` of ``variant`` lives: the first whose whole lineage is the same."""
        lineage = self._lineage(stage, variant)
        return next(name for name in variant_names() if self._lineage(stage, name) == lineage)

    def _is_given(self, stage: str, variant: str) -> bool:
        """Whether the dataset gives what the stage would estimate."""
        return bool(STAGES[stage].given) and self.config(variant)[stage]["provider"] == "dataset"

    def _reads(self, stage: str, variant: str) -> dict[str, str]:
        """Input name -> place, as in :class:`Stage`, of a stage in this configuration."""
        entry = STAGES[stage]
        return {**entry.reads, **(entry.given if self._is_given(stage, variant) else {})}

    # paths

    def cameras(self, sequence: str, which: str = "all") -> list[str]:
        """Names of the cameras of a sequence: ``all`` or ``train``."""
        return self._adapter.cameras(sequence, which)

    def sources(self, sequence: str) -> list[str]:
        """The user's files a sequence is made of."""
        return [str(path) for path in self._adapter.sources(sequence)]

    def downloads(self) -> list[str]:
        """Files the ``fetch`` stage brings for this dataset; empty for a user's own."""
        return [str(path) for path in self._adapter.downloads()]

    def folder(self, stage: str, sequence: str, variant: str) -> str:
        """Folder of a stage's artifacts."""
        return f"results/{self.dataset}/{sequence}/{self.owner(stage, variant)}/{stage}"

    def inputs(self, stage: str, sequence: str, variant: str, camera: str | None = None) -> dict[str, str | list[str]]:
        """Input files by name; a per-camera family of a sequence-level stage is a list."""
        result: dict[str, str | list[str]] = {}
        for name, entry in self._reads(stage, variant).items():
            if entry.startswith("="):
                result[name] = entry[1:]
                continue
            above, _, file = entry.partition("/")
            folder = self.folder(above, sequence, variant)
            if "{camera}" not in file:
                result[name] = f"{folder}/{file}"
            elif camera is not None:
                result[name] = f"{folder}/{file.format(camera=camera)}"
            else:
                names = self.cameras(sequence, STAGES[above].cameras)
                result[name] = [f"{folder}/{file.format(camera=c)}" for c in names]
        return result

    def outputs(self, stage: str, sequence: str, variant: str) -> list[str]:
        """Every file a stage leaves for a sequence."""
        entry = STAGES[stage]
        cameras = self.cameras(sequence, entry.cameras) if entry.per_camera else [None]
        folder = self.folder(stage, sequence, variant)
        return [path for camera in cameras for path in output_paths(entry, folder, camera).values()]

    def everything(self) -> list[str]:
        """Every artifact of every stage, sequence and variant, so that a deleted one is made again."""
        return sorted(
            {
                path
                for sequence in self.sequences
                for variant in self.variants
                for stage in self.stages(sequence)
                for path in self.outputs(stage, sequence, variant)
            }
        )

    def stages(self, sequence: str) -> list[str]:
        """The stages a sequence runs through.

        The monocular check needs cameras to be checked against; truth and maps a dataset that knows something.
        """
        several, knowing = len(self.cameras(sequence)) > 1, bool(self._adapter.provides)
        made = {"monocular": several, "truth": knowing, "maps": knowing}
        return [name for name in STAGES if made.get(name, True)]

    # jobs that know no sequence

    def dataset_job(self, stage: str) -> tuple[dict[str, Any], dict[str, Any]]:
        """Configuration and files of a job for the whole dataset: ``fetch`` or ``report``."""
        config = self.config("full")
        if stage == "fetch":
            folder = f"data/datasets/{self.dataset}"
            return {"seed": config["seed"], "dataset": config["dataset"]}, {
                "inputs": {},
                "outputs": {"data": folder, "provenance": f"{folder}/provenance.json"},
            }
        folder = f"results/{self.dataset}/report"
        outputs = {name: f"{folder}/{file}" for name, file in REPORT.items()}
        return {"seed": config["seed"], "report": config["report"], "jobs": self.jobs()}, {
            "inputs": {},
            "outputs": outputs,
        }

    def jobs(self) -> list[dict[str, Any]]:
        """One entry per job whose evidence the report shows, in DAG order, sharing resolved.

        Each has ``sequence``, ``variant``, ``stage``, ``camera`` (or null), ``files`` (name -> path) and ``benchmark``.
        """
        entries: dict[str, dict[str, Any]] = {}
        for sequence in self.sequences:
            for variant in self.variants:
                for name in self.stages(sequence):
                    stage = STAGES[name]
                    for camera in self.cameras(sequence, stage.cameras) if stage.per_camera else [None]:
                        folder = self.folder(name, sequence, variant)
                        owner = self.owner(name, variant)
                        files = output_paths(stage, folder, camera)
                        key = files["provenance"]
                        entries.setdefault(
                            key,
                            {
                                "sequence": sequence,
                                "variant": owner,
                                "stage": name,
                                "camera": camera,
                                "files": files,
                                "benchmark": benchmark_path(self.dataset, sequence, owner, name, camera),
                            },
                        )
        return list(entries.values())


REPORT = {
    "report": "report.html",
    "markdown": "report.md",
    "table": "metrics.csv",
    "provenance": "provenance.json",
}
"""Files of the ``report`` stage, below results/{dataset}/report."""


def benchmark_path(dataset: str, sequence: str, variant: str, stage: str, camera: str | None) -> str:
    """Where Snakemake writes wall time and memory of a job."""
    name = stage if camera is None else f"{stage}.{camera}"
    return f"results/{dataset}/{sequence}/{variant}/.jobs/{name}.tsv"


def folders(files: Mapping[str, str | Iterable[str]]) -> dict[str, str]:
    """What a stage receives: of a family of files, and of the models' manifest, the folder; nothing of no files."""
    result = {}
    for name, value in files.items():
        if isinstance(value, str):
            result[name] = str(Path(value).parent) if name == "models" else value
        elif first := next(iter(value), None):
            result[name] = str(Path(first).parent)
    return result


def output_paths(stage: Stage, folder: str, camera: str | None) -> dict[str, str]:
    """Output name -> path of one job."""
    return {name: f"{folder}/{file}".replace("{camera}", camera or "") for name, file in stage.files.items()}
