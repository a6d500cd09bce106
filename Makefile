# Everything from a bare machine with Python 3.11+, gcc and make. The first run of any target fills $(VENV) (network);
# later runs need neither network nor set-up. `make` lists the targets.

PYTHON ?= python3
VENV ?= .venv
OUT ?= out

BIN := $(VENV)/bin
READY := $(VENV)/.ready

.DEFAULT_GOAL := help
.PHONY: help setup demo docs test test-all coverage lint format bench mutants clean distclean

help:
	@echo "make demo      crane: OCP -> C -> check against IPOPT -> closed loop -> picture, all in $(OUT)/"
	@echo "make test      formatter, linter, type checker, tests"
	@echo "make test-all  the same, and what is exhaustive"
	@echo "make coverage  lines and branches of src/ that the tests of make test do not reach"
	@echo "make lint      formatter, linter, type checker"
	@echo "make format    apply the formatters: ruff, and clang-format to the C parts if it is there"
	@echo "make bench     times, bytes, instructions and draws beside their baseline, on one page"
	@echo "make docs      the site, in $(OUT)/site/; a dead link is an error"
	@echo "make mutants   whether the tests see the faults that are put into a copy"
	@echo "make clean     remove $(OUT)/ and caches; make distclean also $(VENV)/"
	@echo "Variables: PYTHON=$(PYTHON) VENV=$(VENV) OUT=$(OUT)"

setup: $(READY)

$(READY): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	    echo "$(PYTHON) is missing or older than 3.11; name another one: make PYTHON=python3.12 ..."; exit 1; }
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $@

demo: $(READY)
	$(BIN)/nmpc-export examples/crane.py -o $(OUT)/crane --check
	$(BIN)/python examples/crane.py $(OUT)/crane $(OUT)/crane.png
	@echo
	@echo "C package:  $(OUT)/crane/ (start with $(OUT)/crane/README.md and crane.h)"
	@echo "picture:    $(OUT)/crane.png"
	@echo "problem:    examples/crane.py"

docs: $(READY)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict -f site/mkdocs.yml -d $(abspath $(OUT))/site
	@echo "site: $(OUT)/site/index.html; to read it with its search: $(BIN)/python -m http.server -d $(OUT)/site"

lint: $(READY)
	$(BIN)/ruff format --check
	$(BIN)/ruff check
	$(BIN)/mypy

format: $(READY)
	$(BIN)/ruff format
	@! command -v clang-format >/dev/null || find templates -name '*.c' -exec clang-format -i {} +

test: lint
	$(BIN)/python -m pytest -n auto -q -ra

test-all: lint
	$(BIN)/python -m pytest -n auto -q -ra -m "slow or not slow"

coverage: $(READY)
	$(BIN)/coverage erase
	$(BIN)/coverage run -m pytest -n auto -q
	$(BIN)/coverage combine -q
	$(BIN)/coverage report --sort=cover --skip-covered

mutants: $(READY)
	$(BIN)/python -m verification.mutants

bench: $(READY)
	$(BIN)/python -m benchmarks --json $(OUT)/benchmarks.json

clean:
	rm -rf $(OUT) .pytest_cache .mypy_cache .ruff_cache .hypothesis .coverage*
	find . -name __pycache__ -not -path './$(VENV)/*' -prune -exec rm -rf {} +

distclean: clean
	rm -rf $(VENV)
