# Everything runs in .venv, which the targets make when it is missing or out of date.

SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:

VENV := .venv
BIN := $(VENV)/bin
OUT ?= out
# Worker processes of the tests: one more than two cores, because tests also wait.
JOBS ?= 3
# Whether pages of tasks show an episode; it is played for that.
REPLAYS ?= 0
# The tests that `make test` runs. Plain `pytest` runs all.
SELECT ?= not slow
# The code whose types `make test` checks; `make types TYPED=` adds that of the tests.
TYPED ?= src scripts examples integrations
# How Sphinx builds: `make test` has it read the pages and resolve links, no more.
BUILDER ?= html
BUILDER_OF_TEST ?= dummy
# The first interpreter of a supported version; `make PYTHON=/path/to/python` overrules.
PYTHON ?= $(shell for p in python3 python3.13 python3.12 python3.11; do \
	$$p -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 14))' \
	2>/dev/null && echo $$p && break; done)
INSTALL := $(BIN)/python -m pip install -qq -c constraints.txt
INPUTS := pyproject.toml constraints.txt Makefile scripts/prepare_system.py
CHECKED := src tests examples scripts docs integrations

export PIP_DISABLE_PIP_VERSION_CHECK := 1
# Tests start hundreds of interpreters: each would compile the whole package again.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: help setup setup-dev play demo bench test test-all lint types layers docs \
	tests test-lerobot test-warp test-vla-eval format clean

help: ## Say what the targets do.
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "make %-12s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

setup: $(VENV)/core.stamp ## Make .venv with what the `lemma` command needs.

setup-dev: $(VENV)/dev.stamp ## Add what the tests and the documentation need.

play: $(VENV)/play.stamp ## A page in the browser: say something, watch two robots do it.
	$(BIN)/lemma play

demo: $(VENV)/page.stamp ## The expert solves one instance of each task; videos and replays in out/demo.
	$(BIN)/lemma demo --out $(OUT)/demo

bench: setup ## Measure speed and the expert's success (takes long).
	$(BIN)/lemma bench --expert

test: setup-dev ## All checks, and the tests that are not marked `slow`.
	$(MAKE) -j $(JOBS) lint layers
	@# Tests wait now and then; checks that take a minute fill that time.
	$(MAKE) -j $(JOBS) BUILDER=$(BUILDER_OF_TEST) types docs tests

test-all: export SELECT :=
test-all: export TYPED :=
test-all: export BUILDER_OF_TEST := html
test-all: test ## All checks and all tests.

lint: setup-dev ## Style, formatting and spelling.
	$(BIN)/ruff check $(CHECKED)
	$(BIN)/ruff format --check $(CHECKED)
	$(BIN)/codespell

types: setup-dev ## Static types.
	$(BIN)/mypy $(TYPED)

layers: setup-dev ## Which module may import which.
	$(BIN)/lint-imports

docs: setup-dev ## The documentation, in out/docs; with `REPLAYS=1`, tasks can be seen moving.
	$(BIN)/sphinx-build -q -W --keep-going -b $(BUILDER) -D replays=$(REPLAYS) docs $(OUT)/docs

tests: setup-dev ## The tests alone; `make tests SELECT=` adds the slow ones.
	@# Neighbors share what is made for them: they stay together until a worker is idle.
	$(BIN)/pytest -n $(JOBS) --dist worksteal -m "$(SELECT)"

# lerobot asks for Python 3.12 and for other versions of torch and NumPy than anybody
# needs who works on this package: it has an environment of its own (6 GB).
# Where no Python 3.12 or 3.13 is found, `make LEROBOT_PYTHON=/path/to/python` says it.
LEROBOT_PYTHON ?= $(shell for p in python3.12 python3.13 python3 \
	$(wildcard $(HOME)/.pyenv/versions/3.12.*/bin/python); do \
	$$p -c 'import sys; sys.exit(not (3, 12) <= sys.version_info < (3, 14))' \
	2>/dev/null && echo $$p && break; done)
LEROBOT_VENV := .venv-lerobot
LEROBOT_PLUGIN := integrations/lerobot_env_lemma

test-lerobot: $(LEROBOT_VENV)/smolvla.stamp ## The real lerobot exports, trains and evaluates.
	$(LEROBOT_VENV)/bin/python -m pytest -q -p no:cacheprovider \
		-c tests/lerobot/pytest.ini --confcutdir=tests/lerobot tests/lerobot

$(LEROBOT_VENV)/smolvla.stamp: pyproject.toml $(LEROBOT_PLUGIN)/pyproject.toml
	@if [ -z "$(LEROBOT_PYTHON)" ]; then \
		echo "No Python 3.12 or 3.13 was found. Say where it is:" \
		"make test-lerobot LEROBOT_PYTHON=/path/to/python" >&2; exit 1; fi
	@echo "Installing lerobot into $(LEROBOT_VENV) (6 GB, some minutes) ..."
	@$(LEROBOT_PYTHON) -m venv --clear $(LEROBOT_VENV)
	@$(LEROBOT_VENV)/bin/python -m pip install -qq -e '.[lerobot]' -e $(LEROBOT_PLUGIN) \
		'lerobot[smolvla]' pytest
	@touch $@

# Only parity with MuJoCo Warp needs it (0.5 GB, and torch); a CPU will do.
WARP_VENV := .venv-warp

test-warp: $(WARP_VENV)/stamp ## MuJoCo Warp sees and does what the CPU does; learners take it.
	$(WARP_VENV)/bin/python -m pytest -q -p no:cacheprovider \
		tests/scene/test_ray_tracer.py tests/gpu

$(WARP_VENV)/stamp: pyproject.toml constraints.txt
	@echo "Installing MuJoCo Warp into $(WARP_VENV) ..."
	@$(PYTHON) -m venv --clear $(WARP_VENV)
	@$(WARP_VENV)/bin/python -m pip install -qq -c constraints.txt -e '.[warp]' \
		hypothesis pytest 'skrl==2.1.1' 'rsl-rl-lib==5.5.1'
	@touch $@

# vla-eval is needed for its own test alone (1.3 GB).
VLA_EVAL_VENV := .venv-vla-eval

test-vla-eval: $(VLA_EVAL_VENV)/stamp ## The real vla-eval plays LEMMA.
	$(VLA_EVAL_VENV)/bin/python -m pytest -q -p no:cacheprovider \
		-c tests/vla_eval/pytest.ini --confcutdir=tests/vla_eval \
		tests/vla_eval/check_vla_eval.py

$(VLA_EVAL_VENV)/stamp: pyproject.toml constraints.txt integrations/vla_eval/pyproject.toml
	@echo "Installing vla-eval into $(VLA_EVAL_VENV) ..."
	@$(PYTHON) -m venv --clear $(VLA_EVAL_VENV)
	@$(VLA_EVAL_VENV)/bin/python -m pip install -qq -c constraints.txt \
		-e '.[serve]' -e integrations/vla_eval pytest
	@touch $@

format: setup-dev ## Format the code and fix what can be fixed.
	$(BIN)/ruff format $(CHECKED)
	$(BIN)/ruff check --fix $(CHECKED)

clean: ## Remove caches and everything that was written to out/.
	rm -rf $(OUT) dist .hypothesis .import_linter_cache .mypy_cache .pytest_cache .ruff_cache .test_cache
	find $(CHECKED) -name __pycache__ -prune -exec rm -rf {} +

$(VENV)/core.stamp: $(INPUTS)
	@if [ -z "$(PYTHON)" ]; then \
		echo "No Python 3.11, 3.12 or 3.13 was found. Install one (Debian, Ubuntu:" \
		"apt-get install python3 python3-venv) or say where it is:" \
		"make PYTHON=/path/to/python" >&2; exit 1; fi
	@$(PYTHON) scripts/prepare_system.py
	@$(BIN)/python -m pip --version >/dev/null 2>&1 || $(PYTHON) -m venv --clear $(VENV)
	@echo "Installing the packages into $(VENV) ..."
	@$(INSTALL) -e .
	@touch $@

# The page and replays, without the packages of models that read sentences.
$(VENV)/page.stamp: $(VENV)/core.stamp
	@$(INSTALL) -e '.[play]'
	@touch $@

$(VENV)/play.stamp: $(VENV)/core.stamp
	@echo "Installing the page, and what reads sentences, into $(VENV) ..."
	@$(INSTALL) -e '.[play,learn]'
	@touch $@

$(VENV)/dev.stamp: $(VENV)/core.stamp
	@$(PYTHON) scripts/prepare_system.py --browser
	@echo "Installing the development tools into $(VENV) ..."
	@$(INSTALL) -e '.[dev,docs]'
	@echo "Compiling numerical kernels (a minute) ..."
	@$(BIN)/python scripts/compile_kernels.py >/dev/null
	@touch $@
