# Everything a user or the CI needs. Each target builds what it needs of the environment, once.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
RUN := $(VENV)/.run-installed
DEV := $(VENV)/.dev-installed
COMPILED := $(VENV)/.compiled
PIP = $(BIN)/python -m pip install --quiet --no-compile --disable-pip-version-check -c .ci/constraints.txt

.PHONY: demo test test-all lint check format samples accept bench soak bench-coverage bench-diagnosis bench-grab clean

# what running needs
$(RUN): pyproject.toml .ci/constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "verify needs Python 3.11 or newer: make PYTHON=python3.12 ...")'
	@echo "environment: $(VENV), packages that running needs"
	@$(PYTHON) -m venv $(VENV)
	@$(PIP) -e .
	@touch $@

# what tests and checks need besides
$(DEV): $(RUN)
	@echo "environment: packages that tests and checks need"
	@$(PIP) -e '.[dev]'
	@touch $@

# once, not at the first measurement
$(COMPILED): $(RUN)
	@echo "machine code of the inner loops, once: about a minute of processor time"
	@$(BIN)/python -m verify.compile_ahead
	@touch $@

# status 1 says that the robot does not conform, as this one should not
demo: $(RUN)
	@echo "sample session: measured, compared, reported in demo-report/"
	@$(BIN)/verify run sample_sessions/multi_joint_fault_6r -o demo-report --force --tolerance 0.2; \
	status=$$?; [ $$status -le 1 ] || exit $$status

# the quick suite: every room, every command once from end to end
test: $(DEV) $(COMPILED)
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "not slow and not realtime and not browser"

# all of it: what is slow, statistical, in real time or in a browser as well
test-all: $(DEV) $(COMPILED)
	$(BIN)/python -m pytest -n 3 --dist worksteal

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

bench: $(DEV)
	$(BIN)/python -m tests.bench
	$(BIN)/python -m tests.bench.fleet_pixels

soak: $(DEV)
	$(BIN)/python -m tests.bench.soak

bench-coverage: $(DEV)
	$(BIN)/python -m tests.bench.coverage
	$(BIN)/python -m tests.bench.calibration
	$(BIN)/python -m tests.bench.registration
	$(BIN)/python -m tests.bench.whole_chain

bench-diagnosis: $(DEV)
	$(BIN)/python -m tests.bench.judged
	$(BIN)/python -m tests.bench.diagnosis

bench-grab: $(DEV)
	$(BIN)/python -m tests.bench.grab --full
	$(BIN)/python -m tests.bench.grab_closed
	$(BIN)/python -m tests.bench.grab_emulated

clean:
	rm -rf $(VENV) build *.egg-info
