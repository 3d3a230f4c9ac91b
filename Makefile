# `make demo` and `make test` set up everything they need in .venv, on a fresh machine too.
PYTHON ?= python3
VENV := .venv
RUN := $(VENV)/bin/python
INSTALLED := $(VENV)/installed
SOURCES := $(shell find csrc cmake -type f) setup.py pyproject.toml CMakeLists.txt constraints.txt

.PHONY: demo test lint benchmark clean

$(INSTALLED): $(SOURCES)
	$(PYTHON) -m venv $(VENV)
	$(RUN) -m pip install --quiet --upgrade pip
	$(RUN) -m pip install --quiet --constraint constraints.txt torch
	$(RUN) -m pip install --quiet --constraint constraints.txt --editable .[dev]
	touch $@

demo: $(INSTALLED)
	$(RUN) examples/demo.py --output runs/demo

test: $(INSTALLED)
	$(RUN) -m pytest

lint: $(INSTALLED)
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/clang-format --dry-run --Werror $$(git ls-files 'csrc/*.h' 'csrc/*.cpp' 'csrc/*.cu')

benchmark: $(INSTALLED)
	$(RUN) -m benchmarks --json benchmarks.json

clean:
	rm -rf $(VENV) build dist *.egg-info touchnet/_C*.so
