# install: what users need. dev: the tools of developers too; every target below it sees to that by itself, again when dependencies change.
PYTHON ?= python3
VENV ?= .venv
# An index of packages to take torch from. None: what pip takes by itself, which on Linux is the CUDA build, a download of 2 to 3 GB.
# The selector on pytorch.org gives the address of the CPU builds, a tenth of that: make install TORCH_INDEX=ADDRESS
TORCH_INDEX ?=

PIP := $(VENV)/bin/pip --disable-pip-version-check
INSTALLED := $(VENV)/.installed
DEV := $(VENV)/.dev

.PHONY: install demo dev compiled test test-fast check fuzz docs

install: $(INSTALLED)

$(INSTALLED): pyproject.toml constraints.txt
	@echo "Installing idf-slam and the packages that it uses into $(VENV): some minutes, and about 2 GB with a CPU build of torch."
	$(PYTHON) -m venv $(VENV)
	$(PIP) install --retries 2 --no-deps -c constraints.txt $(TORCH_INDEX:%=--extra-index-url %) torch
	$(PIP) install -c constraints.txt -e .
	@touch $(INSTALLED)
	@echo "Done. Try it: make demo. Or: source $(VENV)/bin/activate, then idf-slam --help."

demo: $(INSTALLED)
	$(VENV)/bin/idf-slam demo

dev: $(DEV)

$(DEV): $(INSTALLED)
	@echo "Installing what the tests and checks use: some minutes, and about 1 GB."
	$(PIP) install -c constraints.txt -e '.[dev]'
	@touch $(DEV)

# A demo of two frames has the kernels compiled, so that no test waits for them. What is compiled is kept until a source of kernels changes.
compiled: $(DEV)
	@$(VENV)/bin/python -c "from idfslam.compute.cache_folder import kernels_on_disk; exit(not kernels_on_disk())" || { \
	echo "Compiling kernels: about a minute."; \
	$(VENV)/bin/idf-slam demo --frames 2 --device cpu --no-report --overwrite --out $(VENV)/demo > $(VENV)/demo.log 2>&1 || (cat $(VENV)/demo.log; exit 1); }

# Two processes, each with test modules of its own: much of the time goes into compiling kernels and starting programs, on one core.
PYTEST = $(VENV)/bin/pytest --numprocesses 2 --dist loadfile --no-loadscope-reorder

test: compiled
	$(PYTEST)

test-fast: compiled
	$(PYTEST) -m "not slow"

check: $(DEV)
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy
	$(VENV)/bin/lint-imports --no-logo

# Damaged files of every kind that is read. The files of each fault are kept.
MUTATIONS ?= 200000
fuzz: $(DEV)
	PYTHONPATH=tests $(VENV)/bin/python -m fuzz --mutations $(MUTATIONS) --keep $(VENV)/fuzz

docs: $(DEV)
	NO_MKDOCS_2_WARNING=1 $(VENV)/bin/mkdocs build --strict  # the variable: no notice of the theme about its successor
