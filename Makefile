# `make demo` and `make test` work in a bare clone: they set up .venv first, which takes minutes once and nothing after.

PYTHON ?= python3
WORKERS ?= 2
BIN := .venv/bin
READY := .venv/ready

.DEFAULT_GOAL := help
.PHONY: help demo test test-slow lint format notebooks docs bench clean

help: ## show this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "make %-10s  %s\n", $$1, $$2}' $(MAKEFILE_LIST)
	@echo "Variables: PYTHON=$(PYTHON) makes .venv (delete .venv to start anew), WORKERS=$(WORKERS) run the tests."

demo: $(READY) ## render, denoise and compare a stereo frame (about two minutes)
	@$(BIN)/python -m fovden demo

test: lint ## all that CI runs: lint, types, import rules, tests and doctests
	@OMP_NUM_THREADS=1 $(BIN)/python -m pytest -q -n $(WORKERS) --dist worksteal -m "not slow"

test-slow: $(READY) ## the tests that take minutes
	@$(BIN)/python -m pytest -q -m slow

lint: $(READY) ## ruff, mypy and import-linter
	@$(BIN)/ruff check --quiet
	@$(BIN)/ruff format --check --quiet
	@$(BIN)/mypy --no-error-summary
	@$(BIN)/lint-imports --no-logo

format: $(READY) ## rewrite the sources in the common format
	@$(BIN)/ruff check --fix --quiet
	@$(BIN)/ruff format

notebooks: $(READY) ## write notebooks/*.ipynb from the scripts beside them, and executed copies to out/notebooks
	@$(BIN)/jupytext --quiet --update --to ipynb notebooks/*.py
	@mkdir -p out/notebooks && cp notebooks/*.ipynb out/notebooks
	@$(BIN)/jupyter-execute --inplace --kernel_name=python3 out/notebooks/*.ipynb

docs: $(READY) ## build the documentation; NOTEBOOK=full runs its notebook at full size, which takes minutes
	@$(if $(filter full,$(NOTEBOOK)),,FOVDEN_SMALL=1) $(BIN)/python -m sphinx -W --keep-going -q \
	  -d out/docs-cache/pages docs out/docs
	@echo "Open out/docs/index.html"

bench: .venv-bench/ready ## measure speed beside peers, for the documentation's tables (half an hour); BENCH=--quick tries
	@set -e; for name in rays frame build growth cold_start flip atrous atrous_polar mapping; do \
	  .venv-bench/bin/python -m benchmarks.$$name $(BENCH); done

clean: ## remove results, caches and builds; .venv stays
	@rm -rf build dist out .mypy_cache .pytest_cache .ruff_cache .import_linter_cache .hypothesis
	@find fovden tests experiments benchmarks -name __pycache__ -type d -prune -exec rm -rf {} +

# The project is installed in editable form, so that only a change of its requirements asks for another installation.
$(READY): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "fovden needs Python 3.11 or later, and $(PYTHON) is: $$($(PYTHON) --version 2>&1)." >&2; \
	  echo "Name another one: make PYTHON=python3.12 $(MAKECMDGOALS)" >&2; exit 1; }
	@echo "Setting up .venv; the first time takes some minutes."
	@$(PYTHON) -m venv .venv
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	@touch $(READY)

# The peers are large, and only benchmarks need all of them.
.venv-bench/ready: pyproject.toml constraints.txt benchmarks/requirements.txt
	@echo "Setting up .venv-bench; the first time takes some minutes."
	@$(PYTHON) -m venv .venv-bench
	@.venv-bench/bin/python -m pip install --quiet --disable-pip-version-check \
	  -c constraints.txt -r benchmarks/requirements.txt -e '.[oracle]'
	@touch .venv-bench/ready
