"""Variants of one configuration: which stages they share, where their files lie, which jobs there are."""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from soar.errors import ConfigError
from soar.workflow.configuration import canonical, composed, overrides_from, variant_names
from soar.workflow.paths import benchmark_path, fill, output_paths
from soar.workflow.table import BROUGHT, CONF, DEFAULT_BODY, MODELS, REPORT, STAGES


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
        self._check_body_models()
        known = self._adapter.sequences()
        self.sequences: list[str] = list(base["sequences"] or known)
        if set(self.sequences) - set(known):
            raise ConfigError("unknown sequence", expected=", ".join(known), got=", ".join(self.sequences))
        self._check_brought()

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
                        cure=f"choose one of those for {stage}, or a dataset that knows, such as dataset=synthetic",
                    )

    def _check_body_models(self) -> None:
        for variant in self.variants:
            node = self.config(variant)["body_model"]
            options = sorted(path.stem for path in (CONF / "body_model").glob("*.yaml"))
            if node["provider"] not in options:
                raise ConfigError("unknown body model", expected=", ".join(options), got=str(node["provider"]))
            if "source" not in node:
                continue
            chosen = f"body_model={node['provider']}"
            if "body" in self._adapter.provides:
                raise ConfigError(
                    f"{chosen}: the people of the dataset {self.dataset} are known as bodies of the default model",
                    expected="body_model=anny",
                    got=chosen,
                    cure=f"choose body_model=anny, or a dataset other than {self.dataset}",
                )
            if node["source"] is None or not Path(node["source"]).is_file():
                raise ConfigError(
                    f"{chosen} needs the model file, which you bring",
                    expected="body_model.source names a file",
                    got="nothing" if node["source"] is None else f"{node['source']}, which is not there",
                    cure=f"snakemake --config {chosen} 'overrides=[\"body_model.source=SMPLX_NEUTRAL.npz\"]'; "
                    "docs/body.md tells where the file comes from",
                )

    def _check_brought(self) -> None:
        for variant in self.variants:
            for name, stage in STAGES.items():
                for sequence in self.sequences:
                    for camera in self.cameras(sequence, stage.cameras) if stage.per_camera else [None]:
                        for key, path in self.brought(name, sequence, variant, camera).items():
                            if not Path(path).exists():
                                raise ConfigError(
                                    f"the stage {name} is given {key}={path}, which is not there",
                                    cure="correct the path in conf/ or in the override; {sequence} and {camera} in it "
                                    "stand for the names of those",
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
        fixed = sorted(self._fixed(path, variant) for path in reads if path.startswith("="))
        return canonical([self.slice(stage, variant), {name: self._lineage(name, variant) for name in above}, fixed])

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

    def _fixed(self, entry: str, variant: str) -> str:
        """The path of an entry that is no stage's, see :class:`Stage`."""
        return entry[1:].replace("{body_model}", self.body_model(variant))

    def brought(self, stage: str, sequence: str, variant: str, camera: str | None = None) -> dict[str, str]:
        """Files and folders of the user's that the configuration of a stage names: key -> path, placeholders filled."""
        config = self.config(variant)
        result: dict[str, str] = {}
        for node in STAGES[stage].config:
            if node != "dataset":  # whose files are those of its adapter
                named = {key: config[node].get(key) for key in BROUGHT}
                result |= {key: fill(path, sequence, camera) for key, path in named.items() if path is not None}
        return result

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
                result[name] = self._fixed(entry, variant)
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
        return result | self.brought(stage, sequence, variant, camera)

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

    def body_model(self, variant: str) -> str:
        """The body record of a variant. The name of one that is made of a user's file tells its configuration apart."""
        node = self.config(variant)["body_model"]
        if "source" not in node:
            return DEFAULT_BODY
        return f"{MODELS}/body/{node['provider']}-{hashlib.sha256(canonical(node).encode()).hexdigest()[:12]}.npz"

    def body_model_job(self, variant: str) -> tuple[dict[str, Any], dict[str, Any]]:
        """Configuration and files of the job that makes a variant's body record of a file of the user's.

        Raises:
            ConfigError: the variant works with the default body.
        """
        config, record = self.config(variant), self.body_model(variant)
        if record == DEFAULT_BODY:
            raise ConfigError(
                "the default body comes with the other model files", cure="run `python -m soar models fetch`"
            )
        return {"seed": 0, "body_model": config["body_model"]}, {
            "inputs": {"default": DEFAULT_BODY, "source": config["body_model"]["source"]},
            "outputs": {"body_model": record, "provenance": f"{record.removesuffix('.npz')}.provenance.json"},
        }

    def body_model_jobs(self) -> dict[str, tuple[dict[str, Any], dict[str, Any]]]:
        """Name of each record that is made of a file of the user's -> its job, :meth:`body_model_job`."""
        records = {self.body_model(variant): variant for variant in self.variants}
        return {
            Path(record).stem: self.body_model_job(variant)
            for record, variant in records.items()
            if record != DEFAULT_BODY
        }

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
