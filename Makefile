# `make` lists the targets. Everything is installed into .venv, with the versions of constraints.txt.
# Each target sets up .venv first, if pyproject.toml or constraints.txt have changed since.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
# Tests often wait for processes and browsers, so there are more of them than cores.
WORKERS = $(shell $(PYTHON) -c "import os; print(os.cpu_count() * 3 // 2)")

# Otherwise each of the many processes that tests start would compile the package again.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.PHONY: help setup train check test durations lint prose types format docs figures fingerprint \
	hostile reference gpu wheel clean

# Tests that need no training: a habit of every change. `make test` runs all.
FAST := tests/ground tests/graphs tests/test_house.py \
	tests/test_figures.py tests/test_public_names.py tests/commands/test_all_commands.py

help:  ## List the targets
	@grep -hE '^[a-z]+:.*##' $(MAKEFILE_LIST) | awk -F ':.*## ' '{printf "  make %-10s %s\n", $$1, $$2}'

# Python compiles what is imported, which is a small part of what is installed.
PIP := $(BIN)/pip install --quiet --disable-pip-version-check --no-compile --constraint constraints.txt
# uv takes a tenth of the time. It does not read pip's settings, which may name another index.
UV := $(BIN)/uv pip install --quiet --python $(BIN)/python --constraint constraints.txt

$(READY): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(PIP) torch uv
	$(UV) --editable '.[test,lint]' || $(PIP) --editable '.[test,lint]'
	@touch $@

setup: $(READY)  ## Install everything into .venv

train: setup  ## Evolve a skill up to stage S2 (ten seconds)
	$(BIN)/cgtorch-train --stage S2

check: lint  ## Lint, then the fast tests: less than a minute, for every change
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist worksteal $(FAST)

test: setup  ## Run all tests (up to 14 minutes on two cores)
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n $(WORKERS) --dist worksteal

durations: setup  ## Run all tests, and print the 40 slowest
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n $(WORKERS) --dist worksteal --durations 40

lint: setup types prose  ## Check style, types and prose
	$(BIN)/ruff check
	$(BIN)/ruff format --check

prose: setup  ## Check README, documentation, help texts and docstrings against docs/style.md
	$(BIN)/python tools/check_prose.py

docs: setup  ## Build the documentation into site/
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

types: setup  ## Check types
	$(BIN)/mypy

figures: setup  ## Write the tables and plots of the pages from docs/figures, and what they show of the code
	$(BIN)/python tools/make_figures.py
	$(BIN)/python tools/make_reference.py
	$(BIN)/python tools/draw_architecture.py

format: setup  ## Format the code
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

fingerprint: setup  ## Print one number of a small run, to compare machines
	$(BIN)/python tools/fingerprint.py

gpu: setup  ## Test all kernels on this machine's GPU, and time them
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -q -m '' tests/simulation/test_gpu_engine.py tests/evolution/test_gpu_operators.py tests/native/test_gpu.py
	$(BIN)/python tools/benchmark.py --device cuda

hostile: setup  ## Damage files, kill runs, ranks and a robot's run, try more examples (an hour)
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -m hostile
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -m hypothesis --hypothesis-profile thorough
	$(BIN)/python tools/fuzz.py
	$(BIN)/python tools/kill_and_resume.py "$$(mktemp --directory)"
	$(BIN)/python tools/kill_rank.py "$$(mktemp --directory)"
	$(BIN)/python tools/kill_robot_run.py "$$(mktemp --directory)"

reference: setup  ## Make runs/reference again (3 minutes)
	$(BIN)/python tools/make_reference_run.py

wheel: setup  ## Build a wheel into dist, with libraries for Linux, and try it without a compiler
	$(PIP) --editable '.[wheel]'
	rm -rf build/wheel dist
	CGTORCH_CPUS=all $(BIN)/python -m build --wheel --no-isolation --outdir build/wheel
	PATH="$(CURDIR)/$(BIN):$$PATH" $(BIN)/auditwheel repair --wheel-dir dist build/wheel/*.whl
	$(BIN)/python tools/try_wheel.py dist/*.whl

clean:  ## Remove the environment and caches
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache .hypothesis build dist site
