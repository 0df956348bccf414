PYTHON ?= python3
BIN := .venv/bin
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt

.PHONY: demo test test-raytrace check package bench clean

demo: .venv/installed  ## map, 30,000 training flights, evaluation and report of the thesis's first scenario
	$(BIN)/cellpilot run thesis-2d --out runs/demo --force

test: .venv/installed-dev  ## every test
	$(BIN)/python -m pytest -n auto --slow

test-raytrace: .venv/installed-raytrace  ## the tests that trace rays; needs LLVM, see `cellpilot doctor`
	$(BIN)/python -m pytest --raytrace tests/maps/test_maps_raytraced.py

check: .venv/installed-dev  ## style, types, architecture
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

package:  ## sdist -> wheel -> a fresh environment elsewhere, and two commands there
	PYTHON=$(PYTHON) .ci/package

bench: .venv/installed-bench  ## speed beside Stable-Baselines3 and eager PyTorch
	$(BIN)/python benchmarks/bench.py

.venv/bin/python:
	$(PYTHON) -m venv .venv

.venv/installed: pyproject.toml constraints.txt | .venv/bin/python
	$(INSTALL) --editable .
	@touch $@

.venv/installed-dev: pyproject.toml constraints.txt | .venv/bin/python
	$(INSTALL) --editable '.[dev]'
	@touch $@ .venv/installed

.venv/installed-raytrace: pyproject.toml constraints.txt | .venv/bin/python
	$(INSTALL) --editable '.[dev,raytrace]'
	@touch $@ .venv/installed .venv/installed-dev

.venv/installed-bench: pyproject.toml constraints.txt | .venv/bin/python
	$(INSTALL) --editable '.[bench]'
	@touch $@ .venv/installed

clean:
	rm -rf .venv runs
