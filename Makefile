# `make help` lists the targets. Blender 5.0 is built for Python 3.11, Blender 5.2 for 3.13.
SUPPORTED := 3.11 3.13
version_of = $(shell $(1) -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null)
# The machine's own python3 if it's supported, else the newest one that is.
PYTHON ?= $(firstword $(foreach python,python3 python3.13 python3.11,$(if $(filter $(SUPPORTED),$(call version_of,$(python))),$(python))))
VENV ?= .venv
BIN := $(VENV)/bin
DEMO ?= hulldown-demo
STUDY ?= hulldown-study
# tanks, or cars from above; COCO folders `train` and `dev` of photographs of them, which aren't part of the project; a folder of weights, if not the
# hub's.
SET ?= tanks
PHOTOGRAPHS ?= ../shared/photographs/$(SET)
WEIGHTS ?=
STAMP := $(VENV)/.installed
TRAINING_STAMP := $(VENV)/.installed-training
INSTALL := $(BIN)/python -m pip install --disable-pip-version-check --constraint constraints.txt --editable
# Processes that test: each has at most one Blender at a time.
WORKERS ?= 2
PYTEST = $(BIN)/python -P -m pytest -n $(WORKERS) --dist loadfile

.DEFAULT_GOAL := help
# What depends on how floats are rounded, where another processor's kernels might be seen; pytest refuses a missing file.
KERNEL_TESTS = $(addprefix tests/,$(addsuffix .py,base/test_portable geometry/test_transforms geometry/test_hulls scene/test_instances \
	placement/test_settle placement/test_rest placement/test_footprint camera/test_cameras placement/test_clearance annotate/test_boxes))

.PHONY: help setup setup-training browser demo study photographs test test-blender kernels check bench thorough fuzz clean

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## /{printf "  make %-15s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup: $(STAMP) ## create .venv and install hulldown, Blender, the libraries it needs, and the development tools (PYTHON=python3.13)

$(STAMP): pyproject.toml constraints.txt
	@[ -n "$(filter $(SUPPORTED),$(call version_of,$(PYTHON)))" ] || { echo "Blender is built for Python 3.11 and 3.13, and\
	 $(or $(PYTHON),python3) is $$($(or $(PYTHON),python3) -V 2>&1): install one of them, for example with uv python install 3.13,\
	 and run make setup PYTHON=/path/to/python3.13" >&2; exit 2; }
	@echo "$(VENV) gets $$($(PYTHON) -V), $$(command -v $(PYTHON))"
	@$(PYTHON) -P reading/libraries.py
	$(PYTHON) -m venv $(VENV)
	$(INSTALL) '.[blender,cluster,dev,geo]'
	@touch $@

setup-training: $(TRAINING_STAMP) ## the same with PyTorch, RF-DETR and Albumentations: 6 GB more

$(TRAINING_STAMP): $(STAMP)
	$(INSTALL) '.[blender,cluster,dev,geo,training,readers]'
	@touch $@

demo: setup ## build demo assets, plan, render, annotate: ends in hulldown-demo/contact_sheet.png (DEMO=folder: elsewhere)
	$(BIN)/hulldown demo --output $(DEMO)

study: setup-training ## what rendered images are worth beside stand-ins for photographs: half an hour; ends in a report (STUDY=folder: elsewhere)
	$(BIN)/python -m hulldown.benchmarks.stand_ins $(STUDY)
	$(BIN)/hulldown study run $(STUDY)/study.toml -o $(STUDY)/study
	$(BIN)/hulldown study report $(STUDY)/study

photographs: setup-training ## what renders are worth beside photographs: hours (SET=cars, PHOTOGRAPHS=folder, WEIGHTS=folder); ends in a report below STUDY
	$(BIN)/python -m hulldown.benchmarks.photographs $(SET) $(STUDY)/$(SET) $(PHOTOGRAPHS) $(if $(WEIGHTS),--weights $(WEIGHTS))
	test -e $(STUDY)/$(SET)/renders.jsonl || $(BIN)/hulldown plan $(STUDY)/$(SET)/renders.toml -o $(STUDY)/$(SET)/renders.jsonl
	$(BIN)/hulldown render $(STUDY)/$(SET)/renders.jsonl -o $(STUDY)/$(SET)/renders
	$(BIN)/hulldown study run $(STUDY)/$(SET)/study.toml -o $(STUDY)/$(SET)/study
	$(BIN)/hulldown study report $(STUDY)/$(SET)/study

browser: ## install Chromium and its driver, which tests of pages need: on Debian and Ubuntu, as root
	@command -v chromedriver >/dev/null && command -v chromium >/dev/null || \
	if command -v apt-get >/dev/null && [ "$$(id -u)" = 0 ]; then \
		apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends chromium chromium-driver; \
	else echo "tests of pages need Chromium and its chromedriver: without them they are skipped, and make test fails" >&2; fi

test: setup-training browser ## all tests but the thorough ones: 8 minutes on two idle cores (WORKERS=4: on four)
	HULLDOWN_NO_SKIPS=1 $(PYTEST)

test-blender: setup browser ## the tests of Blender and geometry alone, without the extra training
	HULLDOWN_NO_SKIPS=1 HULLDOWN_WITHOUT='training readers' $(PYTEST) -m 'blender and not thorough'
	HULLDOWN_NO_SKIPS=1 HULLDOWN_WITHOUT='training readers' $(PYTEST) -m 'not blender and not thorough' $(KERNEL_TESTS) property_tests

kernels: setup ## the tests of geometry, placement and cameras once more, with OpenBLAS's other kernels
	for core in Haswell SkylakeX; do OPENBLAS_CORETYPE=$$core $(BIN)/python -P -m pytest -q $(KERNEL_TESTS) || exit 1; done

check: setup ## linters: ruff, mypy, import rules, who opens files, names, spelling
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -P -m pytest -q tests/base/test_outside.py tests/base/test_names.py
	git ls-files -z ':!.dev' | xargs -0 $(BIN)/codespell

bench: setup ## speed against error: rewrites docs/benchmarks.md and its plots (BENCH='boxes --quick': one suite, small)
	$(BIN)/python -m hulldown.benchmarks $(BENCH)

thorough: setup-training browser kernels ## what make test leaves out: long tests, all shapes checked, thousands of examples: hours
	HULLDOWN_NO_SKIPS=1 HULLDOWN_SHAPES=all $(PYTEST) -m thorough
	HYPOTHESIS_PROFILE=thorough $(PYTEST) --timeout=14400 property_tests

fuzz: setup-training ## 20,000 configs, plans, datasets and .blend files of any contents for each test: hours
	HULLDOWN_SHAPES=off HYPOTHESIS_PROFILE=thorough $(BIN)/python -P -m pytest --timeout=14400 --hypothesis-show-statistics \
	$(wildcard property_tests/test_any_*.py) property_tests/test_blend_files.py

clean: ## remove what the other targets made, .venv included
	rm -rf .venv .venv313 $(DEMO) $(STUDY) build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache *.egg-info
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
