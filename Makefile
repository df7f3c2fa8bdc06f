# The same commands that the README and .ci/run use.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PORT ?= 8000

.PHONY: default setup page up check test bench soak fuzz fmt clean
default: check test

# Installed once per state of the project's own requirement files.
$(VENV)/.installed: pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable ".[client,service,s3,dev]"
	$(BIN)/python -m udflow.compile_loops
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
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest --numprocesses 3 --dist loadfile --no-loadscope-reorder --durations 15

# Every method on every shape in every condition, what docs/results has not yet: hours. With Open3D
# where BENCH_PEERS names a Python that has it.
bench: setup
	$(BIN)/python benchmarks/bench.py --only-new --save

# What `make test` does in short, for as long as it takes: every fault, 500 jobs, 2 000 submissions,
# many generated requests, 500 frames.
soak: page
	rm -f soak.txt
	SOAK=$(CURDIR)/soak.txt $(BIN)/python -m pytest --timeout 7200 \
		tests/chaos tests/end_to_end/test_schema.py tests/end_to_end/test_page.py
	cat soak.txt

# Ten minutes for every format that is read.
fuzz: setup
	rm -f fuzz.txt
	SOAK=$(CURDIR)/fuzz.txt $(BIN)/python -m pytest tests/fuzz --timeout 36000
	cat fuzz.txt

fmt: setup
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .
	cd web && npm run format

clean:
	rm -rf $(VENV) .udflow web/node_modules web/dist
