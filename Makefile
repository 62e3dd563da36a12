# Every command runs in an environment of its own, .venv, which the first command makes.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
FRACBENCH := $(BIN)/python -m fracbench

.DEFAULT_GOAL := help
.PHONY: help setup table2 figures paper beyond fluids publish check check-all test test-all test-python docs fuzz mutants \
  coverage locks lint format clean

help: ## list the commands
	@awk -F ':.*## ' '/^[a-z0-9_-]+:.*## / { printf "  make %-12s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

setup: $(VENV)/.ready ## make the environment (every other command does so when needed)

PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check

$(VENV)/.ready: pyproject.toml locks/dev.txt
	$(PYTHON) -m venv $(VENV)
	$(PIP) --require-hashes --requirement locks/dev.txt
	$(PIP) --no-deps --no-build-isolation --editable .
	@touch $@

$(VENV)/.tools: $(VENV)/.ready locks/tools.txt
	$(PIP) --require-hashes --requirement locks/tools.txt
	@touch $@

$(VENV)/.docs: $(VENV)/.ready locks/docs.txt
	$(PIP) --require-hashes --requirement locks/docs.txt
	@touch $@

table2: $(VENV)/.ready ## compute Table 2 of the paper, published beside recomputed
	$(FRACBENCH) table 2

figures: $(VENV)/.ready ## draw all figures of the paper
	for number in 1 2 3 4 5 6 7; do $(FRACBENCH) figure $$number || exit; done

paper: $(VENV)/.ready ## write all tables and figures of the paper and a verdict on every claim on one page
	$(FRACBENCH) report

beyond: $(VENV)/.ready ## run the experiments beyond the paper and add them to that page
	$(FRACBENCH) report --beyond

fluids: $(VENV)/.ready ## compare with cross-correlation and other flows on fluids (adds the extras peers and piv)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt \
	  --editable '.[dev,peers,piv]'
	$(FRACBENCH) experiment fluids

publish: $(VENV)/.ready ## maintainers: renew results/committed and README.md's answer (ONLY="accurate fluids")
	$(BIN)/python -m tools.publish $(ONLY)

check: $(VENV)/.ready ## recompute the stored tables and compare them cell by cell
	$(FRACBENCH) check

check-all: ## run all checks of a change, as CI does: lint, test, test-python, check, docs
	$(MAKE) lint
	$(MAKE) test
	$(MAKE) test-python
	$(MAKE) check
	$(MAKE) docs

test: $(VENV)/.ready ## run all tests
	$(BIN)/python -m pytest --numprocesses 2 --dist loadfile

test-all: $(VENV)/.tools ## run all tests on each supported Python that is installed, and with the lowest versions
	$(BIN)/nox

fuzz: $(VENV)/.tools ## fuzz the readers of files, words, configurations and stores, 10 minutes each (MINUTES=1)
	$(BIN)/python tools/fuzz.py --minutes $(or $(MINUTES),10)

mutants: $(VENV)/.tools ## change the code in 200 random places and list the changes that no test sees (MUTANTS=20)
	$(BIN)/python tools/mutants.py --number $(or $(MUTANTS),200)

coverage: $(VENV)/.tools ## run all tests and print the branches that they take, by room
	$(BIN)/python tools/coverage_by_room.py

locks: $(VENV)/.tools ## maintainers: renew locks/ from pyproject.toml and constraints.txt
	for lock in dev:3.11 docs:3.11.5 tools:3.11; do $(BIN)/uv pip compile --quiet --universal \
	  --extra $${lock%:*} --python-version $${lock#*:} --output-file locks/$${lock%:*}.txt \
	  --constraint constraints.txt --generate-hashes --no-emit-index-url --no-emit-find-links --no-annotate \
	  --custom-compile-command 'make locks' pyproject.toml || exit; done

test-python: $(VENV)/.ready ## test the numerics without compilation, as plain Python
	NUMBA_DISABLE_JIT=1 $(BIN)/python -m pytest -q $(addprefix tests/model/, $(addsuffix .py, \
	  kernels/test_cosine kernels/test_pointwise kernels/test_forward_rows kernels/test_exponential_sum \
	  kernels/test_line_elimination test_sweeps test_warping test_pyramid))

docs: $(VENV)/.docs ## build the documentation site in build/site, and check it: spelling, warnings, notebook, browser
	$(BIN)/codespell
	mkdir -p build/notebook && cp docs/tutorial.ipynb build/notebook
	$(BIN)/python -m pytest -q --nbmake build/notebook/tutorial.ipynb
	$(BIN)/python -m sphinx --quiet --fail-on-warning --keep-going --doctree-dir build/doctrees docs build/site
	$(BIN)/python -m pytest -q tests/test_site.py

lint: $(VENV)/.ready ## check style and types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(VENV)/.ready ## format the code
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

clean: ## remove the environment and everything computed
	rm -rf $(VENV) docs/auto_gallery docs/generated results/figures results/private results/runs results/sweeps results/tables build dist
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
