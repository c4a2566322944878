# Everything a newcomer runs: `make validate` (the main job) and `make test`; `make test-slow` is the rest of the tests.
# Either makes .venv first when it is lacking or older than the lock.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
READY_DEV := $(VENV)/.ready-dev
REPORT ?= reports/validate
# Processes that share the tests, whole files at a time, since what a module sets up is set up once; long ones first.
TEST_WORKERS ?= auto
PYTEST = $(BIN)/python -m pytest -n $(TEST_WORKERS) --dist loadfile --no-loadscope-reorder
SCORES ?= reports/scoreboard

# One thread per matrix product: the last digits of a solve depend on the number of threads.
export OPENBLAS_NUM_THREADS ?= 1
export OMP_NUM_THREADS ?= 1
# One kernel, too: one line of a simulated collection drew other photons where the processor had wider registers.
ifeq ($(shell uname -m),x86_64)
export OPENBLAS_CORETYPE ?= Haswell
# With the kernel named, the OpenBLAS of NumPy 2.5 ends in a segmentation fault on virtual machines that report no
# second-level cache.  Its size [KiB] changes no digit.
export OPENBLAS_L2_SIZE ?= 512
endif
# Modules are compiled once: without their compiled files each of the many processes of the tests takes two seconds more.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help setup validate check power sample-report scoreboard test test-slow test-all test-data lint check-style format types lock clean coverage cover docs docs-check bill audit robustness conformance

help:  ## this list
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## /  make \1\t/' | expand -t 24

setup: $(READY)  ## make .venv from requirements.lock

$(READY): requirements.lock pyproject.toml
	@PYTHON="$(PYTHON)" VENV="$(VENV)" sh scripts/setup.sh
	@touch $(READY)

$(READY_DEV): $(READY) requirements-dev.lock
	@PYTHON="$(PYTHON)" VENV="$(VENV)" sh scripts/setup.sh requirements-dev.lock
	@touch $(READY_DEV)

# GREATEST_EXIT=1 takes gates that disagree for a result: `make check` says whether they are the accepted ones.
validate: $(READY)  ## run every campaign; the report is in reports/validate
	$(BIN)/hyperval validate campaigns/*/campaign*.yaml -o $(REPORT) || [ $$? -le $(or $(GREATEST_EXIT),0) ]

# CHECK_FROM=$(REPORT) takes the campaigns' numbers from a finished `make validate`.
check: $(READY)  ## compare every campaign and sensor with the accepted numbers
	$(BIN)/hyperval check campaigns/*/campaign*.yaml --sensors all --junit reports/check.xml $(if $(CHECK_FROM),--from $(CHECK_FROM))

power: $(READY)  ## inject standard errors in the model of every campaign: which gates see them? (tens of minutes)
	$(BIN)/hyperval power campaigns/*/campaign*.yaml -o reports/power

sample-report: $(READY)  ## renew reports/sample from the public collections (a minute)
	$(BIN)/python scripts/sample_reports.py

scoreboard: $(READY)  ## rank detectors, engines and formulations on every campaign; the page is in reports/scoreboard
	$(BIN)/hyperval benchmark campaigns/*/campaign.yaml -o $(SCORES)

test: $(READY_DEV)  ## run the tests, but for slow ones and studies of chance
	$(PYTEST) -m "not slow and not simulation" $(TEST_FLAGS)

test-slow: $(READY_DEV)  ## run the others: twins, grids of the atmosphere engine, pages in a browser, how often intervals hold
	$(PYTEST) -m "slow or simulation" $(TEST_FLAGS)

test-all: $(READY_DEV)  ## both in one run, which sets up once what both need
	$(PYTEST) $(TEST_FLAGS)

# One by one: a single file takes longer than all the others.
test-data: $(READY_DEV)  ## run the tests of real collections (HYPERVAL_DATA), slow ones too
	$(PYTEST) --dist worksteal -m data $(TEST_FLAGS)

coverage: $(READY_DEV)  ## how often the 95 % intervals hold, over simulated collections (15 minutes; goes on where it ended)
	$(BIN)/python validation/coverage/study.py --output reports/coverage

conformance: $(READY)  ## read the public files at hand (HYPERVAL_DATA): as second readers do, or refused as expected?
	$(BIN)/python validation/conformance.py

robustness: $(READY_DEV)  ## a million damaged files through every reader (an hour; goes on where it ended)
	$(BIN)/python validation/robustness/mutation_study.py --output reports/robustness

cover: $(READY_DEV)  ## lines and branches that the fast tests reach (minutes); COVER_FLAGS=--show-missing
	$(BIN)/python -m coverage run -m pytest -q -p no:xdist -m "not slow and not simulation and not data"
	$(BIN)/python -m coverage report $(COVER_FLAGS)

bill: $(READY)  ## every package that hyperval needs, with version and licence; BILL_FLAGS=--cyclonedx for other tools
	$(BIN)/python scripts/bill_of_materials.py $(BILL_FLAGS)

audit: $(READY)  ## known weaknesses of the locked packages (needs pip-audit, and reaches its database)
	@command -v pip-audit >/dev/null || { echo "make audit needs pip-audit: $(PYTHON) -m pip install pip-audit" >&2; exit 2; }
	pip-audit --requirement requirements.lock --requirement requirements-dev.lock --disable-pip --no-deps

docs: $(READY)  ## render the documentation, its examples run; build/docs/index.html
	@$(BIN)/python -c "import furo, myst_nb, sphinx_gallery" 2>/dev/null || \
	  PYTHON="$(PYTHON)" VENV="$(VENV)" sh scripts/setup.sh requirements-docs.lock
	$(BIN)/python -m sphinx -W --keep-going -q -b html docs build/docs

docs-check: $(READY_DEV) docs  ## follow every link of the rendered documentation, ask it five questions, search it (needs chromium)
	$(BIN)/python scripts/docs_check.py build/docs reports/docs

lint: $(READY_DEV)  ## check style, which room imports which, and that nothing outgrows budgets.toml
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/lint-imports
	$(BIN)/python scripts/lines_of_code.py --check

check-style: lint

format: $(READY_DEV)  ## mend style
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

types: $(READY_DEV)  ## check the types
	$(BIN)/mypy src

COMPILE = uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-header $(LOCK_FLAGS)

lock:  ## renew the locks after a change of dependencies (needs uv)
	@command -v uv >/dev/null || { echo "make lock needs uv: $(PYTHON) -m pip install uv" >&2; exit 2; }
	$(COMPILE) --group build --extra web pyproject.toml -o requirements.lock
	$(COMPILE) --group pyproject.toml:dev -c requirements.lock -o requirements-dev.lock
	$(COMPILE) --group pyproject.toml:docs -c requirements.lock -c requirements-dev.lock -o requirements-docs.lock

clean:  ## remove .venv and everything that tools left
	rm -rf $(VENV) build dist docs/gallery docs/reference .pytest_cache .import_linter_cache .mypy_cache .ruff_cache .hypothesis
	find src tests validation -name __pycache__ -type d -prune -exec rm -rf {} +
