# Two commands do everything: `make demo` and `make test`.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

.PHONY: demo test lint clean

demo: $(STAMP)
	"$(BIN)/snakemake"
	@echo "report: results/demo/report/report.html"

test: $(STAMP)
	OMP_NUM_THREADS=1 "$(BIN)/python" -m pytest -q -n logical --maxprocesses 4 --dist loadfile

lint: $(STAMP)
	"$(BIN)/ruff" check .
	"$(BIN)/ruff" format --check .
	"$(BIN)/snakefmt" --check Snakefile workflow/rules
	"$(BIN)/mypy"

$(STAMP): pyproject.toml setup.py constraints.txt
	"$(PYTHON)" -c 'import sys; sys.exit(sys.version_info < (3, 11) and "SOAR needs Python 3.11 or newer")'
	"$(PYTHON)" -m venv $(VENV)
	"$(BIN)/python" -m pip install --quiet --upgrade pip setuptools wheel -c constraints.txt
	"$(BIN)/python" -m pip install --quiet -c constraints.txt --no-build-isolation -e '.[dev,imagedream]'
	@touch $(STAMP)

clean:
	rm -rf results/*/ .snakemake
