# What is looked at: videos, figures, the report.


def report_outputs():
    """Files of the report of the whole dataset."""
    return list(FLOW.dataset_job("report")[1]["outputs"].values())


def evidence(w):
    """Everything the report shows."""
    return [path for job in FLOW.jobs() for path in job["files"].values()]


rule render:
    input:
        **reads("render"),
    output:
        **writes("render"),
    log:
        job_file("render", ".log"),
    benchmark:
        job_file("render", ".tsv")
    resources:
        mem_mb=2000,
        runtime=30,
    params:
        **params("render"),
    message:
        "Rendering the turntable of {wildcards.sequence} ({wildcards.variant})"
    shell:
        RUN


rule views:
    input:
        **reads("views"),
    output:
        **writes("views"),
    log:
        job_file("views", ".log"),
    benchmark:
        job_file("views", ".tsv")
    resources:
        mem_mb=2000,
        runtime=30,
    params:
        **params("views"),
    message:
        "Rendering {wildcards.sequence} ({wildcards.variant}) from {wildcards.camera}"
    shell:
        RUN_CAMERA


rule evaluate:
    input:
        **reads("evaluate"),
    output:
        **{k: v for k, v in writes("evaluate").items() if k != "metrics"},
        metrics=report(
            writes("evaluate")["metrics"],
            caption="../report/evaluate.rst",
            category="Figures",
            labels={"sequence": "{sequence}", "variant": "{variant}"},
        ),
    log:
        job_file("evaluate", ".log"),
    benchmark:
        job_file("evaluate", ".tsv")
    threads: 2
    resources:
        mem_mb=3000,
        runtime=60,
    params:
        **params("evaluate"),
    message:
        "Measuring {wildcards.sequence} ({wildcards.variant})"
    shell:
        RUN


rule report:
    input:
        evidence,
    output:
        **FLOW.dataset_job("report")[1]["outputs"],
    log:
        f"results/{FLOW.dataset}/report/report.log",
    resources:
        mem_mb=1500,
        runtime=20,
    params:
        cfg=canonical(FLOW.dataset_job("report")[0]),
        code=fingerprint("report", {}),
        files=canonical(FLOW.dataset_job("report")[1]),
    message:
        "Writing results/{FLOW.dataset}/report/report.html"
    shell:
        RUN_DATASET
