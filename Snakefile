# SOAR: videos of a moving person in, complete animatable avatars and their measurements out.
#
#   snakemake                                   the default dataset, everything that is not up to date
#   snakemake --config dataset=video 'overrides=["dataset.path=my.mp4"]'
#   snakemake --config 'reconstruct={steps: 100}' 'variants=[full,no_implicit]'
#   snakemake results/demo/balance/full/body/body.npz
#
# Rules wire files; what a stage reads, writes and is configured by stands in soar/workflow/table.py.

import sys
from pathlib import Path

from snakemake.exceptions import WorkflowError

sys.path.insert(0, str(Path(workflow.basedir)))


include: "workflow/rules/common.smk"
include: "workflow/rules/setup.smk"
include: "workflow/rules/truth.smk"
include: "workflow/rules/perception.smk"
include: "workflow/rules/body.smk"
include: "workflow/rules/avatar.smk"
include: "workflow/rules/outputs.smk"


rule all:
    default_target: True
    input:
        FLOW.everything(),
        report_outputs(),
    message:
        "Everything is made: results/{FLOW.dataset}/report/report.html"
