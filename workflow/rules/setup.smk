# What fills data/: model files, the body that a user brings and, where a dataset may be downloaded, its footage.


rule models:
    output:
        manifest=f"{MODELS}/manifest.json",
        anny=f"{MODELS}/body/anny.npz",
        helpers=f"{MODELS}/body/anny_helpers.npz",
    log:
        f"{MODELS}/models.log",
    threads: 2
    resources:
        mem_mb=4000,
        runtime=15,
    params:
        cfg=canonical({"seed": 0, "models": FLOW.config("full")["models"]}),
        code=fingerprint("models", {}),
        files=canonical(
            {
                "inputs": {},
                "outputs": {
                    "models": MODELS,
                    "provenance": f"{MODELS}/provenance.json",
                },
            }
        ),
    message:
        "Fetching, checking and converting the model files"
    shell:
        RUN_DATASET


BODY_MODELS = FLOW.body_model_jobs()

if BODY_MODELS:

    rule body_model:
        input:
            default=f"{MODELS}/body/anny.npz",
            source=lambda w: BODY_MODELS[w.record][1]["inputs"]["source"],
        output:
            body_model=f"{MODELS}/body/{{record}}.npz",
            provenance=f"{MODELS}/body/{{record}}.provenance.json",
        log:
            f"{MODELS}/body/{{record}}.log",
        wildcard_constraints:
            record="|".join(BODY_MODELS),
        resources:
            mem_mb=4000,
            runtime=15,
        params:
            cfg=lambda w: canonical(BODY_MODELS[w.record][0]),
            code=fingerprint("body_model", {}),
            files=lambda w: canonical(BODY_MODELS[w.record][1]),
        message:
            "Converting {input.source} to a body record"
        shell:
            RUN_DATASET


if FLOW.downloads():

    rule fetch:
        output:
            FLOW.downloads(),
        log:
            f"data/datasets/{FLOW.dataset}.log",
        resources:
            mem_mb=500,
            runtime=15,
        params:
            cfg=canonical(FLOW.dataset_job("fetch")[0]),
            code=fingerprint("fetch", FLOW.dataset_job("fetch")[0]),
            files=canonical(FLOW.dataset_job("fetch")[1]),
        message:
            "Fetching the dataset {FLOW.dataset}"
        shell:
            RUN_DATASET
