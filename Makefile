# Targets for users and the CI. Each builds the environment that it needs, once.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
RUN := $(VENV)/.run-installed
DEV := $(VENV)/.dev-installed
SITE := $(VENV)/.docs-installed
PIP = $(BIN)/python -m pip install -qq --no-compile --disable-pip-version-check -c .ci/constraints.txt

# packages come without compiled modules; Python keeps what it compiles, also where a container forbids it
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test test-all test-long lint check format samples accept pictures docs bench soak bench-coverage bench-diagnosis bench-grab fuzz clean

# packages that running needs; a C compiler for the inner loops where the machine has none
$(RUN): pyproject.toml .ci/constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "verify needs Python 3.11 or newer: make PYTHON=python3.12 ...")'
	@echo "environment: $(VENV), packages that running needs"
	@$(PYTHON) -m venv $(VENV)
	-@$(PIP) --upgrade pip  # an older one takes twice as long
	@$(PIP) -e .
	@[ -n "$$CC" ] || command -v cc >/dev/null || command -v gcc >/dev/null || command -v clang >/dev/null || $(PIP) -e '.[compiler]'
	@touch $@

# packages that tests and checks need
$(DEV): $(RUN)
	@echo "environment: packages that tests and checks need"
	@$(PIP) -e '.[dev]'
	@touch $@

# packages that the site of the documents needs
$(SITE): $(RUN)
	@echo "environment: packages that the site of the documents needs"
	@$(PIP) -e '.[docs]'
	@touch $@


# status 1: the robot does not conform; the sample has a fault
demo: $(RUN)
	@echo "sample session: measured, compared, reported in demo-report/"
	@$(BIN)/verify run sample_sessions/multi_joint_fault_6r -o demo-report --force --tolerance 0.2; \
	status=$$?; [ $$status -le 1 ] || exit $$status

# the quick suite: every room, every command once from end to end
test: $(DEV)
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "not slow and not realtime and not browser"

# nearly all tests: the slow, the statistical, those in real time and in a browser too
test-all: $(DEV)
	$(BIN)/python -m pytest -n 3 --dist worksteal -m "not long"

# what the CI leaves out for its time: the wheel in a fresh environment, further drivers and reports
test-long: $(DEV)
	$(BIN)/python -m pytest -m long

lint: $(DEV)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

check: lint test-all

format: $(DEV)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

samples: $(DEV)
	$(BIN)/python -m tests.support.samples

accept: $(DEV)
	$(BIN)/python -m pytest tests/golden --accept

# every picture of the documents, and the notebook's outputs: some minutes, and Chromium
pictures: $(DEV)
	$(BIN)/python -m tests.support.pictures

bench: $(DEV)
	$(BIN)/python -m tests.bench

soak: $(DEV)
	$(BIN)/python -m tests.bench.soak
	$(BIN)/python -m tests.bench.soak faults
	$(BIN)/python -m tests.bench.soak kills 100

bench-coverage: $(DEV)
	$(BIN)/python -m tests.bench.coverage
	$(BIN)/python -m tests.bench.coverage --classes
	$(BIN)/python -m tests.bench.spots
	$(BIN)/python -m tests.bench.calibration
	$(BIN)/python -m tests.bench.halves
	$(BIN)/python -m tests.bench.registration
	$(BIN)/python -m tests.bench.whole_chain

bench-diagnosis: $(DEV)
	$(BIN)/python -m tests.bench.judged
	$(BIN)/python -m tests.bench.diagnosis.shares

bench-grab: $(DEV)
	$(BIN)/python -m tests.bench.grasping --full
	$(BIN)/python -m tests.bench.grasping corrected --full

fuzz: $(DEV)
	$(BIN)/python -m tests.fuzz $(or $(N),2000)

# the documents as a site that opens without a network
docs: $(SITE)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet -f .ci/mkdocs.yml
	@echo "site: build/site/index.html"

clean:
	rm -rf $(VENV) build *.egg-info
