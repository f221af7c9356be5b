# The avatar: a baseline without optimisation, the reconstruction, what was never seen.


rule paint:
    input:
        **reads("paint"),
    output:
        **writes("paint"),
    log:
        job_file("paint", ".log"),
    benchmark:
        job_file("paint", ".tsv")
    resources:
        mem_mb=2000,
        runtime=20,
    params:
        **params("paint"),
    message:
        "Painting the baseline of {wildcards.sequence}"
    shell:
        RUN


rule reconstruct:
    input:
        **reads("reconstruct"),
    output:
        **writes("reconstruct"),
    log:
        job_file("reconstruct", ".log"),
    benchmark:
        job_file("reconstruct", ".tsv")
    threads: 2
    resources:
        mem_mb=6000,
        runtime=240,
    params:
        **params("reconstruct"),
    message:
        "Reconstructing {wildcards.sequence} ({wildcards.variant})"
    shell:
        RUN


rule occlusion:
    input:
        **reads("occlusion"),
    output:
        **writes("occlusion"),
    log:
        job_file("occlusion", ".log"),
    benchmark:
        job_file("occlusion", ".tsv")
    threads: 2
    resources:
        mem_mb=2000,
        runtime=30,
    params:
        **params("occlusion"),
    message:
        "Finding what was never seen of {wildcards.sequence} ({wildcards.variant})"
    shell:
        RUN


rule refine:
    input:
        **reads("refine"),
    output:
        **writes("refine"),
    log:
        job_file("refine", ".log"),
    benchmark:
        job_file("refine", ".tsv")
    threads: 2
    resources:
        mem_mb=6000,
        runtime=240,
    params:
        **params("refine"),
    message:
        "Completing {wildcards.sequence} ({wildcards.variant})"
    shell:
        RUN
