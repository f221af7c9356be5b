# Cameras, body, and what is cut out of the frames and said of them.


rule calibrate:
    input:
        **reads("calibrate"),
    output:
        **writes("calibrate"),
    log:
        job_file("calibrate", ".log"),
    benchmark:
        job_file("calibrate", ".tsv")
    resources:
        mem_mb=1500,
        runtime=10,
    params:
        **params("calibrate"),
    message:
        "Refining camera rotations of {wildcards.sequence}"
    shell:
        RUN


rule body:
    input:
        **reads("body"),
    output:
        **writes("body"),
    log:
        job_file("body", ".log"),
    benchmark:
        job_file("body", ".tsv")
    resources:
        mem_mb=3000,
        runtime=60,
    params:
        **params("body"),
    message:
        "Fitting the body of {wildcards.sequence} ({wildcards.variant})"
    shell:
        RUN


rule monocular:
    input:
        **reads("monocular"),
    output:
        **writes("monocular"),
    log:
        job_file("monocular", ".log"),
    benchmark:
        job_file("monocular", ".tsv")
    resources:
        mem_mb=3000,
        runtime=60,
    params:
        **params("monocular"),
    message:
        "Checking a one-camera fit of {wildcards.sequence}"
    shell:
        RUN


rule crops:
    input:
        **reads("crops"),
    output:
        **writes("crops"),
    log:
        job_file("crops", ".log"),
    benchmark:
        job_file("crops", ".tsv")
    resources:
        mem_mb=1500,
        runtime=30,
    params:
        **params("crops"),
    message:
        "Cutting out the person in {wildcards.sequence}, {wildcards.camera}"
    shell:
        RUN_CAMERA


rule normals:
    input:
        **reads("normals"),
    output:
        **writes("normals"),
    log:
        job_file("normals", ".log"),
    benchmark:
        job_file("normals", ".tsv")
    resources:
        mem_mb=2000,
        runtime=30,
    params:
        **params("normals"),
    message:
        "Making normal maps of {wildcards.sequence}, {wildcards.camera}"
    shell:
        RUN_CAMERA


rule caption:
    input:
        **reads("caption"),
    output:
        **writes("caption"),
    log:
        job_file("caption", ".log"),
    benchmark:
        job_file("caption", ".tsv")
    resources:
        mem_mb=1500,
        runtime=15,
    params:
        **params("caption"),
    message:
        "Describing the person in {wildcards.sequence}"
    shell:
        RUN
