# make help says what each target does.
.PHONY: help setup run test lint coverage docs clean

# MPI ranks share the cores, so each keeps to one thread; no screen is needed to draw.
export OMP_NUM_THREADS ?= 1
export OMP_WAIT_POLICY ?= passive
export PYVISTA_OFF_SCREEN ?= true
export MPLBACKEND ?= Agg
# A hundred processes of the tests would compile every module anew.
export PYTHONDONTWRITEBYTECODE :=

RUN_FOLDER ?= runs/screw
# A process per core, four at most (each may take 1 GB); fixtures of a file are made once.
SIDE_BY_SIDE ?= -n auto --maxprocesses 4 --dist loadfile

help: ## this list
	@sed -n 's/^\([a-z]*\):.*## \(.*\)/make \1\t\2/p' Makefile

setup: ## make .venv with everything that is needed (idempotent)
	@.ci/setup

run: setup ## the screw of both alloys, 0 to 24 weeks, quick resolution: runs/screw/report.html
	.venv/bin/perilife run --alloy Mg-5Gd Mg-10Gd --immersion 0w 1w 2w 4w 8w 24w \
		--hold all --resolution quick --out $(RUN_FOLDER) --resume

test: setup ## every test that is not marked slow, files of tests side by side
	.venv/bin/python -m pytest -q $(SIDE_BY_SIDE)

lint: setup ## style and types: ruff (check and format) and mypy
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .
	.venv/bin/mypy

coverage: setup ## the tests with the share of lines that they run, by file: coverage.txt
	.venv/bin/python -m pytest -q $(SIDE_BY_SIDE) --cov=peri --cov=fem --cov=pipeline --cov=data \
		--cov-report=term:skip-covered | tee coverage.txt

docs: setup ## the pages of every module and function: build/docs/index.html
	.venv/bin/pdoc --docformat numpy --no-show-source -o build/docs ./peri ./fem ./pipeline perilife_data

clean: ## remove .venv, runs/screw and caches
	rm -rf .venv $(RUN_FOLDER) build dist ./*.egg-info .pytest_cache .ruff_cache .mypy_cache .hypothesis .coverage coverage.txt
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
