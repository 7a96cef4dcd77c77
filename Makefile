# cgtorch: `make` lists what can be done. Everything is installed into .venv, versions pinned.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready

.DEFAULT_GOAL := help
.PHONY: gpu help setup train test lint docs format types fingerprint reference clean

help:  ## List the targets
	@grep -hE '^[a-z]+:.*##' $(MAKEFILE_LIST) | awk -F ':.*## ' '{printf "  make %-10s %s\n", $$1, $$2}'

$(READY): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt torch
	$(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[test,lint]'
	@touch $@

setup: $(READY)  ## Install everything into .venv

train: setup  ## Evolve a skill up to stage S2 (a minute)
	$(BIN)/cgtorch-train --stage S2

test: setup  ## Run all tests
	$(BIN)/python -m pytest -n auto

lint: setup types  ## Check style and types
	$(BIN)/ruff check
	$(BIN)/ruff format --check

docs: setup  ## Build the documentation into site/
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

types: setup  ## Check types
	$(BIN)/mypy

format: setup  ## Put the code into the house style
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

fingerprint: setup  ## Print one number of a small run, to compare machines by
	$(BIN)/python tools/fingerprint.py

gpu: setup  ## Try all kernels on this machine's GPU, and time them beside its cores
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -q tests/simulation/test_gpu_engine.py tests/evolution/test_gpu_operators.py tests/native/test_nvrtc.py
	$(BIN)/python tools/benchmark.py --device cuda

reference: setup  ## Make runs/reference again
	$(BIN)/python tools/make_reference_run.py

clean:  ## Remove the environment and caches
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache .hypothesis build dist site
