# make run: environment and pipeline; make test: environment and tests. Needs Python 3.11 and make, nothing else.
PYTHON ?= python3.11
export PATH := $(CURDIR)/.venv/bin:$(PATH)
export DVC_NO_ANALYTICS := 1

.PHONY: run test lint renderer

.venv/ready: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	.venv/bin/pip install -q --disable-pip-version-check -c constraints.txt -e ".[dev]"
	touch $@

run: .venv/ready
	dvc repro
	@python -m leapgap.view.where

test: .venv/ready renderer
	pytest

lint: .venv/ready
	ruff check
	ruff format --check
	mypy

# A software renderer, for the test that takes a screenshot; without it that test is skipped.
renderer:
	@ls /usr/share/vulkan/icd.d/*.json >/dev/null 2>&1 \
	|| { apt-get update -qq && apt-get install -y -qq mesa-vulkan-drivers >/dev/null; } 2>/dev/null \
	|| echo "no Vulkan driver, and none could be installed: the screenshot test will be skipped"
