# Cameras, body, and what is cut out of the frames with them.


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
    threads: 2
    resources:
        mem_mb=3000,
        runtime=60,
    params:
        **params("body"),
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
    shell:
        RUN_CAMERA
