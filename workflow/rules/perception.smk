# From footage to frames, keypoints and masks.


rule ingest:
    input:
        lambda w: FLOW.sources(w.sequence),
    output:
        **writes("ingest"),
    log:
        job_file("ingest", ".log"),
    benchmark:
        job_file("ingest", ".tsv")
    resources:
        mem_mb=1000,
        runtime=10,
    params:
        **params("ingest"),
    message:
        "Reading cameras and frame range of {wildcards.sequence}"
    shell:
        RUN


rule frames:
    input:
        **reads("frames"),
    output:
        **writes("frames"),
    log:
        job_file("frames", ".log"),
    benchmark:
        job_file("frames", ".tsv")
    resources:
        mem_mb=1500,
        runtime=30,
    params:
        **params("frames"),
    message:
        "Undistorting frames of {wildcards.sequence}, {wildcards.camera}"
    shell:
        RUN_CAMERA


rule keypoints:
    input:
        **reads("keypoints"),
    output:
        **writes("keypoints"),
    log:
        job_file("keypoints", ".log"),
    benchmark:
        job_file("keypoints", ".tsv")
    resources:
        mem_mb=2000,
        runtime=60,
    params:
        **params("keypoints"),
    message:
        "Tracking the person in {wildcards.sequence}, {wildcards.camera}"
    shell:
        RUN_CAMERA


rule masks:
    input:
        **reads("masks"),
    output:
        **writes("masks"),
    log:
        job_file("masks", ".log"),
    benchmark:
        job_file("masks", ".tsv")
    resources:
        mem_mb=2000,
        runtime=60,
    params:
        **params("masks"),
    message:
        "Masking the person in {wildcards.sequence}, {wildcards.camera}"
    shell:
        RUN_CAMERA
