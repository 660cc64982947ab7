# make demo · make test · make test-backbones · make lint. Each sets up its own environment first, once.

PYTHON := $(shell for p in python3.11 python3.12 python3.13 python3; do \
	command -v $$p >/dev/null 2>&1 && $$p -c 'import sys, venv, ensurepip; sys.exit(not (3, 11) <= sys.version_info < (3, 14))' \
	>/dev/null 2>&1 && { echo $$p; break; }; done)
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
# Networks live in an environment of their own: torch takes gigabytes, and nothing else needs it.
NETWORKS := .venv-backbones
NETWORKS_STAMP := $(NETWORKS)/.installed

.PHONY: demo test test-backbones lint format clean help

help:
	@echo "make demo    map the photos that ship with the project, and compare with the truth"
	@echo "make test    all tests, the slow ones too"
	@echo "make test-backbones    the adapters of networks on their real code (installs torch, 6 GB)"
	@echo "make lint    style, types, floors"
	@echo "make format  bring the code into the house style"

$(STAMP): pyproject.toml constraints.txt
	@test -n "$(PYTHON)" || { echo "Python 3.11, 3.12 or 3.13 with its venv module is needed (Debian: apt install python3-venv)"; exit 2; }
	@echo "setting up $(VENV) with $(PYTHON), once"
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[dev,sim,study]"
	@touch $@

$(NETWORKS_STAMP): pyproject.toml constraints.txt constraints-backbones.txt
	@test -n "$(PYTHON)" || { echo "Python 3.11, 3.12 or 3.13 with its venv module is needed (Debian: apt install python3-venv)"; exit 2; }
	@echo "setting up $(NETWORKS) with $(PYTHON), once"
	@test -x $(NETWORKS)/bin/python || $(PYTHON) -m venv $(NETWORKS)
	@$(NETWORKS)/bin/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -c constraints-backbones.txt \
		-e ".[dev,transformers,yoloe,onnx,depth-anything-3]" pycocotools onnx
	@$(NETWORKS)/bin/python -m pip install --quiet --disable-pip-version-check --no-deps -c constraints-backbones.txt depth-anything-3
	@touch $@

demo: $(STAMP)
	@$(BIN)/excavatwin demo -o demo_output

test: $(STAMP)
	$(BIN)/python -m pytest

test-backbones: $(NETWORKS_STAMP)
	HF_HUB_OFFLINE=1 $(NETWORKS)/bin/python -m pytest -m "not slow" tests/test_backbones_*.py

lint: $(STAMP)
	$(BIN)/ruff check src tests
	$(BIN)/ruff format --check src tests
	$(BIN)/mypy
	$(BIN)/lint-imports

format: $(STAMP)
	$(BIN)/ruff check --fix src tests
	$(BIN)/ruff format src tests

clean:
	rm -rf $(VENV) $(NETWORKS) demo_output .demo_output.cache .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
