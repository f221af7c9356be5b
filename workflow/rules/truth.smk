# What a dataset knows besides its footage; nothing here runs for one that knows nothing.


rule truth:
    input:
        **reads("truth"),
    output:
        **writes("truth"),
    log:
        job_file("truth", ".log"),
    benchmark:
        job_file("truth", ".tsv")
    resources:
        mem_mb=1500,
        runtime=30,
    params:
        **params("truth"),
    message:
        "Writing the known body of {wildcards.sequence}"
    shell:
        RUN


rule maps:
    input:
        **reads("maps"),
    output:
        **writes("maps"),
    log:
        job_file("maps", ".log"),
    benchmark:
        job_file("maps", ".tsv")
    resources:
        mem_mb=1500,
        runtime=60,
    params:
        **params("maps"),
    message:
        "Writing the known masks, normals and depth of {wildcards.sequence}, {wildcards.camera}"
    shell:
        RUN_CAMERA
