# Everything is set up by the first target that needs it: `make demo` or `make test`, and nothing else.

VENV ?= .venv
PYTHON := $(VENV)/bin/python
SUDO := $(shell [ "$$(id -u)" = 0 ] || command -v sudo)
APT := $(SUDO) env DEBIAN_FRONTEND=noninteractive apt-get -qq
SEED ?= 1
SECONDS ?= $(if $(SMOKE),1,60)
PORT ?= 8080
SCENARIO ?= urban
# Sizes of campaigns: SHORT=1 takes two minutes at most and stores no result, FULL=1 is for the best confidence, RUNS=n
# for another one. SMOKE=1 runs one job of a few seconds, to see that the command works. FRESH=1 does again what earlier runs of the same code have found.
CAMPAIGN = $(if $(SMOKE),--smoke,$(if $(SHORT),--short,$(if $(FULL),--full,$(if $(RUNS),--runs $(RUNS))))) $(if $(FRESH),--fresh)
# The same of measurements without jobs.
SIZE = $(if $(SMOKE),--smoke,$(if $(SHORT),--short))

# Each process of a unit would compile its sources: 0.2 to 0.5 s of some 1.5 s of processor time at its start.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help setup demo test quick check calculating types running slow slow-calculating slow-running coverage mutants up down containers docs lock papers attack-lab alarms turns bench drives drives-trust integrity security consistency starts v2x fuzz golden picture bench-replay fleet clean wheel audit
.DEFAULT_GOAL := help

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  %-12s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

setup: $(VENV)/.installed $(VENV)/.dashboard ## install what the unit needs into $(VENV)

# Debian's python3 comes without venv; every other Python brings it.
$(VENV)/bin/python:
	@python3 -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "Python 3.11 or newer is needed, this is $$(python3 --version)"; exit 1; }
	@python3 -c 'import ensurepip, venv' 2>/dev/null || { echo "installing python3-venv"; $(APT) update && $(APT) install -y --no-install-recommends python3-venv; }
	@python3 -m venv $(VENV)

$(VENV)/.installed: requirements.lock pyproject.toml | $(VENV)/bin/python
	@echo "installing the Python packages (about a minute)"
	@$(PYTHON) -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	@$(PYTHON) -m pip install --quiet --disable-pip-version-check --no-deps --editable .
	@touch $@

$(VENV)/.dashboard: services/monitoring/status/dashboard/package-lock.json deploy/install_dashboard.py | $(VENV)/.installed
	@echo "installing the dashboard's libraries"
	@$(PYTHON) deploy/install_dashboard.py
	@touch $@

$(VENV)/.testing: requirements-dev.lock services/monitoring/status/dashboard/package-lock.json | $(VENV)/.installed $(VENV)/.dashboard
	@echo "installing what the tests need"
	@$(PYTHON) -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-dev.lock
	@$(PYTHON) deploy/install_dashboard.py --testing
	@$(PYTHON) -m tests.support.warm
	@touch $@

# The tests talk to a real Mosquitto, a real Chromium and a real gpsd; where they cannot be installed, their tests skip and say so.
$(VENV)/.debian: | $(VENV)/bin/python
	@deploy/install_test_programs.sh "$(SUDO)"
	@touch $@

demo: setup ## drive a simulated car here and print the dashboard's address (SCENARIO=urban SEED=1 PORT=8080)
	@$(PYTHON) -m cli demo --scenario $(SCENARIO) --seed $(SEED) --port $(PORT)

test: ## run every check that CI runs: all but `make slow` and `make containers`
	@$(MAKE) --no-print-directory --jobs=2 $(VENV)/.testing $(VENV)/.debian
	@$(MAKE) --no-print-directory check

check: | $(VENV)/.testing ## the checks alone, on what is installed
	@$(PYTHON) -m ruff check .
	@$(PYTHON) -m ruff format --check .
	@$(MAKE) --no-print-directory --jobs=3 calculating types running

# What a change is compared with, beside what is not committed yet.
BASE ?= HEAD

quick: | $(VENV)/.testing ## lint, architecture, words and the unit tests beside what changed, in a minute (BASE=main: and since then)
	@$(PYTHON) -m ruff check .
	@$(PYTHON) -m ruff format --check .
	@$(PYTHON) -m pytest -q -n auto -m "not slow" tests/architecture tests/unit/shared/words $$($(PYTHON) -m tests.support.changed $(BASE))

# Tests that only calculate, and types, have the time that tests of running programs leave while they wait.
LIVE := tests/integration tests/browser

calculating:
	@nice -n 19 $(PYTHON) -m pytest $(LIVE:%=--ignore=%) -n auto --dist loadfile --no-loadscope-reorder -m "not slow" --durations=20 $(PYTEST_ARGS)

types:
	@nice -n 19 $(PYTHON) -m mypy

running:
	@$(PYTHON) -m pytest $(LIVE) -n auto --dist loadfile --no-loadscope-reorder -m "not slow and not whole_unit" --durations=20 $(PYTEST_ARGS)
	@$(PYTHON) -m pytest $(LIVE) -m "whole_unit and not slow" --durations=15 $(PYTEST_ARGS)

slow: ## run the long tests, those of a whole unit one after the other (OBU_DATA: with recordings)
	@failed=; for part in slow-calculating slow-running; do $(MAKE) --no-print-directory $$part || failed=1; done; [ -z "$$failed" ]

slow-calculating: | $(VENV)/.testing
	@$(PYTHON) -m pytest $(LIVE:%=--ignore=%) -n auto --dist loadfile -m "slow and not container" --durations=20 $(PYTEST_ARGS)

slow-running: | $(VENV)/.testing
	@$(PYTHON) -m pytest $(LIVE) -n auto --dist loadfile -m "slow and not whole_unit and not container" --durations=15 $(PYTEST_ARGS)
	@$(PYTHON) -m pytest $(LIVE) -m "slow and whole_unit and not container" --durations=15 $(PYTEST_ARGS)

coverage: | $(VENV)/.testing ## measure branch coverage of tests that calculate, and which test executes which line
	@mkdir -p .obu/coverage
	@$(PYTHON) -m pytest $(LIVE:%=--ignore=%) -n auto --dist loadfile -m "not slow" --cov --cov-branch --cov-context=test --cov-report= $(PYTEST_ARGS)
	@$(PYTHON) -m coverage report --skip-covered | tail -1

# A run without the data of `make coverage` tries the tests of files that import the one with the fault.
mutants: | $(VENV)/.testing ## put 60 small faults into a copy of the tree, and see which of them the tests find (SEED=1)
	@$(PYTHON) -m benchmarks.mutants --seed $(SEED) $(if $(SMOKE),--number 1,--store) $(if $(wildcard .obu/coverage/data),--coverage .obu/coverage/data)

up: ## start the containers
	@deploy/check_docker.sh
	docker compose up --detach --build

down: ## stop the containers
	docker compose down

containers: | $(VENV)/.testing ## test the containers for real, where there is an engine (three minutes)
	@$(PYTHON) -m pytest -m container $(PYTEST_ARGS)

docs: setup ## print docs/reference, the architecture's picture, obu.target and the age of tables from the code
	@$(PYTHON) -m cli reference
	@$(PYTHON) -m benchmarks.tables

lock: | $(VENV)/.testing ## write the lock files from what is installed
	@$(PYTHON) deploy/lock.py

wheel: $(VENV)/.dashboard ## build the wheel into dist/, with the dashboard
	@$(PYTHON) deploy/wheel.py

audit: | $(VENV)/.dashboard ## ask databases about known weaknesses of the dependencies (needs internet)
	@$(PYTHON) deploy/audit.py

PAPERS := $(if $(SMOKE),motion-conflict,motion-conflict cooperative spoofing toll navigation)
# SHORT: fewer runs, with which every limit still holds. KEEP: the results become those of docs/reference/papers.md.
SHORT_RUNS := motion-conflict=--drives_1 cooperative=--runs_60 spoofing=--drives_9 toll=--runs_2 navigation=--runs_1_--short

papers: setup ## reproduce the papers' numbers (minutes; SHORT=1: fewer runs); all of them, also behind one that fails
	@failed=; for paper in $(PAPERS); do \
		short=; for runs in $(if $(SMOKE)$(SHORT),$(SHORT_RUNS)); do \
			[ "$${runs%%=*}" != $$paper ] || short=$$(echo "$${runs#*=}" | tr _ ' '); done; \
		$(PYTHON) -m cli papers $$paper --out .obu/papers/$$paper $$short || failed="$$failed $$paper"; \
		$(if $(KEEP),cp .obu/papers/$$paper/result.json benchmarks/results/papers/$$paper.json;) \
	done; [ -z "$$failed" ] || { echo "outside their limits:$$failed"; exit 1; }

attack-lab: setup ## attack simulated drives, scored against the truth (11 minutes on two cores)
	@$(PYTHON) -m cli attack-lab $(if $(SMOKE),--attack position_jump@20:3 --after 2 --clean 20 --out .obu/attack-lab-smoke,$(if $(SHORT),--quick --out .obu/attack-lab-short,--out .obu/attack-lab)) \
		$(if $(FULL),--seeds 3 --scenario urban --scenario highway,$(if $(RUNS),--seeds $(RUNS))) $(if $(FRESH),--fresh)

alarms: setup ## count false alarms of the monitors in fault-free epochs (11 minutes)
	@$(PYTHON) -m benchmarks.false_alarms $(CAMPAIGN)
	@$(PYTHON) -m benchmarks.false_alarms_satellites $(CAMPAIGN)

turns: setup ## find the smallest turn rate of a GNSS track that the observer of the gyroscope sees, by grade (10 minutes)
	@$(PYTHON) -m benchmarks.turns $(CAMPAIGN)

bench: $(VENV)/.testing $(VENV)/.debian ## measure latency over the bus and cost of the whole unit (minutes)
	@$(PYTHON) -m benchmarks $(SIZE)

drives: setup ## measure accuracy on the recordings of OBU_DATA beside goals and peers (10 minutes)
	@$(PYTHON) -m benchmarks.navigation $(CAMPAIGN)

drives-trust: setup ## print the verdicts on the recordings of OBU_DATA, and the harm of their exclusions (5 minutes)
	@$(PYTHON) -m benchmarks.navigation.trust $(CAMPAIGN)

security: $(VENV)/.testing $(VENV)/.debian ## try attacks and failures on a running unit and its files, and print the table (13 minutes)
	@$(PYTHON) -m benchmarks.security $(SIZE)

integrity: setup ## hold protection levels against true errors, in drives with a random fault and without, RECORDINGS=folder (7 minutes)
	@$(PYTHON) -m benchmarks.integrity.faults $(CAMPAIGN)
	@$(PYTHON) -m benchmarks.integrity $(CAMPAIGN) $(if $(RECORDINGS),--recordings $(RECORDINGS))

consistency: setup ## hold errors against the filter's covariance (3 minutes)
	@$(PYTHON) -m benchmarks.consistency $(CAMPAIGN)

starts: setup ## switch on anywhere in simulated drives: how soon the heading is known (3 minutes)
	@$(PYTHON) -m benchmarks.starts $(CAMPAIGN)

fuzz: setup ## feed damaged bytes to parsers, readers of files and the link to a centre, SECONDS=60 for each, SEED=1 (20 minutes)
	@$(PYTHON) -m benchmarks.fuzz --seed $(SEED) --seconds $(SECONDS)
	@$(PYTHON) -m benchmarks.fuzz_files --seed $(SEED) --seconds $(SECONDS)
	@$(PYTHON) -m benchmarks.fuzz_fleet --seed $(SEED) --seconds $(SECONDS)

v2x: setup ## measure cost and latency of receiving 2,000 CAM a second, and signed ones (five minutes)
	@$(PYTHON) -m benchmarks.v2x $(if $(SMOKE),--smoke)
	@$(PYTHON) -m benchmarks.v2x.signed $(if $(SMOKE),--smoke)

fleet: $(VENV)/.testing $(VENV)/.debian ## measure a centre with 10,000 vehicles, and kill every part of one (9 minutes)
	@$(PYTHON) -m benchmarks.fleet $(SIZE)

bench-replay: $(VENV)/.testing $(VENV)/.debian ## measure a two-hour recording in the browser: opening, scrubber, memory (half an hour)
	@$(PYTHON) -m benchmarks.replay $(if $(SMOKE),--smoke)

golden: setup ## write the stored result of the golden drive (the difference is to be reviewed)
	@$(PYTHON) -m tests.support.drives.golden
	@$(PYTHON) -m tests.support.words

picture: $(VENV)/.testing $(VENV)/.debian ## take the pictures of every page from running demos (ten minutes)
	@$(PYTHON) -m docs.picture

clean: ## remove what set-up and runs have made
	rm -rf $(VENV) .obu dist services/monitoring/status/dashboard/node_modules .pytest_cache .mypy_cache .ruff_cache
