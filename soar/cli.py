"""Command line: ``python -m soar STAGE`` runs one stage by hand, ``python -m soar models`` looks after the weights,
``python -m soar train NAME`` makes one of the project's own networks.

The DAG calls the same entry with the files and the configuration already worked out (``--files``, ``--cfg``), so that
a stage run by hand and one run by Snakemake are the same code on the same inputs.
"""

from __future__ import annotations

import argparse
import ctypes
import importlib
import json
import os
import shutil
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from soar import workflow
from soar.errors import ConfigError, SoarError


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    options = _parser().parse_args(arguments)
    try:
        options.run(options)
    except SoarError as error:
        print(f"soar: {type(error).__name__}: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("soar: interrupted; nothing half-written is left, the next run continues", file=sys.stderr)
        return 130
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="soar", description="Complete, animatable avatars from a video.")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    models = commands.add_parser("models", help="list the model files: what is there, what is missing, licence, source")
    models.add_argument("action", nargs="?", choices=["list", "fetch", "check"], default="list")
    models.add_argument(
        "path", nargs="?", type=Path, help="check: a file or folder of yours: what it is, what takes it"
    )
    models.add_argument(
        "--with", dest="extra", nargs="*", default=[], metavar="NAME", help="optional models to fetch too"
    )
    models.add_argument("--offline", action="store_true", help="use only what is on disk")
    _job_options(models)
    models.set_defaults(run=_models, stage="models", sequence=None, camera=None)
    train = commands.add_parser("train", help="train or measure one of this project's own networks")
    tasks = train.add_subparsers(required=True, metavar="NETWORK")
    for name in sorted(path.stem for path in (workflow.CONF / "train").glob("*.yaml")):
        task = tasks.add_parser(name, help=f"settings: conf/train/{name}.yaml")
        task.add_argument("overrides", nargs="*", help="Hydra overrides, e.g. train.minutes=30 train.device=cpu")
        task.add_argument("--out", type=Path, help=f"folder of the training (default: data/train/{name})")
        task.add_argument("--evaluate", action="store_true", help="measure the network in --out, or the bundled one")
        task.add_argument("--threads", type=int, default=len(os.sched_getaffinity(0)), help="threads to use")
        task.set_defaults(run=_train, task=name)
    export = commands.add_parser("export-prior", help="write ImageDream's networks as ONNX files (docs/priors.md)")
    export.add_argument("checkpoint", type=Path, help="the released file")
    export.add_argument("folder", type=Path, help="for the ONNX files")
    export.add_argument("--mode", choices=["pixel", "local"], default="pixel", help="default: pixel")
    export.add_argument("--threads", type=int, default=len(os.sched_getaffinity(0)), help="threads to use")
    export.set_defaults(run=_export_prior)
    normals = commands.add_parser("export-normals", help="write ICON's or ECON's normal networks as ONNX files")
    normals.add_argument("checkpoint", type=Path, help="normal.ckpt (docs/normals.md)")
    normals.add_argument("folder", type=Path, help="for the ONNX files")
    normals.add_argument("--threads", type=int, default=len(os.sched_getaffinity(0)), help="threads to use")
    normals.set_defaults(run=_export_normals)
    for name in ("fetch", "body_model", *workflow.STAGES, "report"):
        stage = commands.add_parser(name, help=f"run the stage {name}")
        stage.add_argument("overrides", nargs="*", help="Hydra overrides, e.g. dataset=video dataset.path=my.mp4")
        stage.add_argument("--sequence", help="sequence to run; the only one if there is one")
        stage.add_argument("--variant", default="full", help="variant to run (default: full)")
        stage.add_argument("--camera", help="camera, for stages that run per camera")
        _job_options(stage)
        stage.set_defaults(run=_stage, stage=name)
    return parser


def _job_options(parser: argparse.ArgumentParser) -> None:
    """What the DAG passes: threads, and files and configuration as JSON."""
    parser.add_argument("--threads", type=int, default=len(os.sched_getaffinity(0)), help="threads to use")
    parser.add_argument("--files", type=json.loads, help=argparse.SUPPRESS)
    parser.add_argument("--cfg", type=json.loads, help=argparse.SUPPRESS)


def _models(options: argparse.Namespace) -> None:
    if options.files is not None:
        _stage(options)
        return
    if (options.action == "check") != (options.path is not None):
        raise ConfigError("models check: which file or folder?", cure="python -m soar models check PATH")
    if options.action == "check":
        from soar.models.identify import report
        from soar.stages._forms import FORMS

        print(report(options.path, FORMS))
        return
    from soar.models.describe import bundled, describe, table
    from soar.networks import DATA
    from soar.stages.models import fetch

    folder = Path(workflow.MODELS)
    if options.action == "fetch":
        fetch(folder, workflow.Workflow().config("full")["models"], options.extra, options.offline)
    print(table([*describe(folder), *bundled(DATA)]))


def _train(options: argparse.Namespace) -> None:
    _allot(options.threads)
    from soar.train.registry import task, training

    node = workflow.composed((f"+train={options.task}", *options.overrides))["train"]
    models, folder = Path(workflow.MODELS), options.out or Path("data/train") / options.task
    if options.evaluate:
        network = None if options.out is None else folder / "network.onnx"
        task(options.task, node, models).evaluate(network, folder, options.threads)
    else:
        training(options.task, node, models, folder).run()


def _export_prior(options: argparse.Namespace) -> None:
    _allot(options.threads)
    from soar.priors.imagedream.export import export_checkpoint

    export_checkpoint(options.checkpoint, options.folder, options.mode, Path(workflow.MODELS), options.threads)


def _export_normals(options: argparse.Namespace) -> None:
    _allot(options.threads)
    from soar.perception.icon_export import export_normals

    export_normals(options.checkpoint, options.folder, options.threads)


def _stage(options: argparse.Namespace) -> None:
    _allot(options.threads)
    if options.files is None:
        _by_hand(options)
    execute(
        options.stage,
        {name: Path(path) for name, path in options.files["inputs"].items()},
        {name: Path(path) for name, path in options.files["outputs"].items()},
        options.cfg,
        sequence=options.sequence or "",
        camera=options.camera,
        threads=options.threads,
    )


def _by_hand(options: argparse.Namespace) -> None:
    """Fill in sequence, files and configuration as the DAG would."""
    flow = workflow.Workflow({"overrides": options.overrides})
    if options.stage in ("fetch", "report"):
        options.cfg, options.files = flow.dataset_job(options.stage)
        return
    if options.stage == "body_model":
        options.cfg, options.files = flow.body_model_job(options.variant)
        return
    if options.sequence is None:
        if len(flow.sequences) != 1:
            raise ConfigError("which sequence?", expected=", ".join(flow.sequences), cure="add --sequence NAME")
        options.sequence = flow.sequences[0]
    stage = workflow.STAGES[options.stage]
    if stage.per_camera and options.camera not in flow.cameras(options.sequence):
        raise ConfigError("which camera?", expected=", ".join(flow.cameras(options.sequence)), cure="add --camera NAME")
    options.cfg = flow.slice(options.stage, options.variant)
    folder = flow.folder(options.stage, options.sequence, options.variant)
    options.files = {
        "inputs": workflow.folders(flow.inputs(options.stage, options.sequence, options.variant, options.camera)),
        "outputs": workflow.output_paths(stage, folder, options.camera),
    }


def execute(
    stage: str,
    inputs: Mapping[str, Path],
    outputs: Mapping[str, Path],
    cfg: Mapping[str, Any],
    *,
    sequence: str,
    camera: str | None,
    threads: int,
) -> None:
    """Run one stage and leave its provenance record.

    Raises:
        SoarError: whatever the stage found wrong; no output is left half-written.
    """
    from soar.artifacts import remove_leftovers
    from soar.provenance import record
    from soar.stages import Job

    started = time.perf_counter()
    provenance = outputs["provenance"]
    scratch = provenance.with_name(f".{provenance.stem}.scratch")
    cfg = dict(cfg)
    job = Job(sequence, camera, cfg.pop("seed"), threads, scratch, workflow.fingerprint(stage, cfg))
    for path in outputs.values():
        remove_leftovers(path)
    work = {name: path for name, path in outputs.items() if name != "provenance"}
    importlib.import_module(f"soar.stages.{stage}").run(inputs, work, cfg, job)
    record(provenance, stage, job, inputs, work, cfg, time.perf_counter() - started)
    shutil.rmtree(scratch, ignore_errors=True)


def _allot(threads: int) -> None:
    """Bound the thread pools of every library not yet imported, and keep freed memory mapped.

    The optimisation loops free and allocate buffers of tens of megabytes every step; glibc would return each to the
    system and fault it in again page by page, which costs a third of the time of such a loop.
    """
    for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"):
        os.environ[name] = str(threads)
    # Threads that wait sleep: spinning takes the cores from whatever else runs, and twice the processor time.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    try:
        libc = ctypes.CDLL("libc.so.6")
        mmap_threshold, trim_threshold = -3, -1
        libc.mallopt(mmap_threshold, 1 << 30)
        libc.mallopt(trim_threshold, 1 << 30)
    except (OSError, AttributeError):
        return  # another C library: only slower
