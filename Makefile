# The same commands that the README and .ci/run use.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PORT ?= 8000

.PHONY: default setup page up check test fmt clean
default: check test

# Installed once per state of the project's own requirement files.
$(VENV)/.installed: pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable ".[client,service,s3,dev]"
	touch $@

setup: $(VENV)/.installed

# Built where a Node can be had; without it the service runs, and says so.
page: setup
	$(BIN)/python web/build.py

up: page
	PORT=$(PORT) exec $(BIN)/python -m service.up

check: setup
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python web/build.py check

test: page
	$(BIN)/python web/build.py test
	$(BIN)/python -m pytest

fmt: setup
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .
	cd web && npm run format

clean:
	rm -rf $(VENV) .udflow web/node_modules web/dist
