# Helpers of the rules: everything is asked of soar.workflow.

from soar.errors import SoarError
from soar.workflow import (
    MODELS,
    STAGES,
    Workflow,
    benchmark_path,
    canonical,
    files_of,
    fingerprint,
    folders,
    output_paths,
)

try:
    FLOW = Workflow(config)
    FLOW.jobs()  # so that a calibration that cannot be read is named here
except SoarError as error:
    raise WorkflowError(str(error))


wildcard_constraints:
    sequence="[A-Za-z0-9_.-]+",
    variant="[A-Za-z0-9_]+",
    camera="[A-Za-z0-9_-]+",


PYTHON = sys.executable

# The same command for every stage: quoted JSON carries configuration and files.
RUN = (
    "{PYTHON:q} -m soar {rule} --sequence {wildcards.sequence:q} --threads {threads}"
    " --cfg {params.cfg:q} --files {params.files:q} > {log:q} 2>&1"
)
RUN_CAMERA = RUN.replace("--threads", "--camera {wildcards.camera:q} --threads")
RUN_DATASET = RUN.replace("--sequence {wildcards.sequence:q} ", "")


def folder(stage):
    """Folder of a stage's artifacts, with wildcards."""
    return f"results/{FLOW.dataset}/{{sequence}}/{{variant}}/{stage}"


def input_names(stage):
    """Names of the inputs; those that a dataset may give are empty where they are estimated."""
    return [*STAGES[stage].reads, *STAGES[stage].given]


def reads(stage):
    """Named inputs of a stage as input functions."""

    def path(name):
        return lambda w: FLOW.inputs(
            stage, w.sequence, w.variant, getattr(w, "camera", None)
        ).get(name, [])

    def brought(w):
        """Every file of the user's own that the configuration names."""
        named = FLOW.brought(stage, w.sequence, w.variant, getattr(w, "camera", None))
        return [file for path in named.values() for file in files_of(path)]

    return {name: path(name) for name in input_names(stage)} | {"brought": brought}


def writes(stage):
    """Named outputs of a stage."""
    return {
        name: f"{folder(stage)}/{file}" for name, file in STAGES[stage].files.items()
    }


def params(stage):
    """Configuration and code as text, whose change re-runs the stage; files, which are no trigger of their own."""

    def files(wildcards, input, output):
        camera = getattr(wildcards, "camera", None)
        named = {name: getattr(input, name) for name in input_names(stage)}
        named |= FLOW.brought(stage, wildcards.sequence, wildcards.variant, camera)
        place = FLOW.folder(stage, wildcards.sequence, wildcards.variant)
        return canonical(
            {
                "inputs": folders(named),
                "outputs": output_paths(STAGES[stage], place, camera),
            }
        )

    return {
        "cfg": lambda w: canonical(FLOW.slice(stage, w.variant)),
        "code": lambda w: fingerprint(stage, FLOW.slice(stage, w.variant)),
        "files": files,
    }


def job_file(stage, suffix):
    """Log or benchmark of a job, out of the way of the artifacts."""
    camera = "{camera}" if STAGES[stage].per_camera else None
    path = benchmark_path(FLOW.dataset, "{sequence}", "{variant}", stage, camera)
    return path.removesuffix(".tsv") + suffix
