"""What the Snakefile needs to know: stages, their files, configuration and code, and which variants share work.

Hydra composes the configuration once per variant when the Snakefile is parsed. A stage declares in ``table`` the files
it reads and writes and the configuration nodes it sees; a job receives exactly those nodes as one canonical JSON
string. Two variants whose configuration and code agree for a stage *and all stages above it* share its artifacts; the
sharing is computed from the table, never listed by hand.

This package is imported at every parse and imports no numerical library.
"""

from soar.workflow.configuration import canonical, composed, overrides_from
from soar.workflow.fingerprints import fingerprint
from soar.workflow.flow import Workflow
from soar.workflow.paths import benchmark_path, files_of, folders, output_paths
from soar.workflow.table import CONF, MODELS, SETUP, STAGES

__all__ = [
    "CONF",
    "MODELS",
    "SETUP",
    "STAGES",
    "Workflow",
    "benchmark_path",
    "canonical",
    "composed",
    "files_of",
    "fingerprint",
    "folders",
    "output_paths",
    "overrides_from",
]
