# install: once, and again when the dependencies change; every other target sees to it by itself.
PYTHON ?= python3
VENV ?= .venv
STAMP := $(VENV)/.installed
COMPILED := $(VENV)/.compiled

.PHONY: install demo test test-fast check docs

install: $(STAMP)

$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(VENV)/bin/pip install -qq --disable-pip-version-check -c constraints.txt -e '.[dev]'
	@touch $(STAMP)

demo: $(STAMP)
	$(VENV)/bin/idf-slam demo

# Numba keeps what it has compiled in src/. A demo of two frames has the kernels compiled once, so that no test waits for them.
$(COMPILED): $(STAMP)
	$(VENV)/bin/idf-slam demo --frames 2 --device cpu --no-report --overwrite --out $(VENV)/demo > $(VENV)/demo.log 2>&1 || (cat $(VENV)/demo.log; exit 1)
	@touch $(COMPILED)

# Two processes, each with test modules of its own: much of the time goes into compiling kernels and starting programs, on one core.
PYTEST = $(VENV)/bin/pytest --numprocesses 2 --dist loadfile --no-loadscope-reorder

test: $(COMPILED)
	$(PYTEST)

test-fast: $(COMPILED)
	$(PYTEST) -m "not slow"

check: $(STAMP)
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy
	$(VENV)/bin/lint-imports --no-logo

docs: $(STAMP)
	$(VENV)/bin/pip install -qq --disable-pip-version-check -c constraints.txt -e '.[docs]'
	NO_MKDOCS_2_WARNING=1 $(VENV)/bin/mkdocs build --strict  # the variable: no notice of the theme about its successor
