# Everything a user or the CI needs; each target builds the environment first, once.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
WARM := $(VENV)/.warm

.PHONY: demo test lint check format samples accept bench soak bench-coverage bench-diagnosis bench-grab clean

$(STAMP): pyproject.toml .ci/constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "verify needs Python 3.11 or newer: make PYTHON=python3.12 ...")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c .ci/constraints.txt -e '.[dev]'
	@touch $@

# what is compiled, once and not at the first measurement
$(WARM): $(STAMP)
	$(BIN)/python -m verify.compile_ahead
	@touch $@

# status 1 says that the robot does not conform, as this one should not
demo: $(WARM)
	@$(BIN)/verify run sample_sessions/multi_joint_fault_6r -o demo-report --force --tolerance 0.2; \
	status=$$?; [ $$status -le 1 ] || exit $$status

test: $(WARM)
	$(BIN)/python -m pytest -n 3 --dist worksteal

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

check: lint test

format: $(STAMP)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

samples: $(STAMP)
	$(BIN)/python -m tests.support.samples

accept: $(STAMP)
	$(BIN)/python -m pytest tests/golden --accept

bench: $(STAMP)
	$(BIN)/python -m tests.bench
	$(BIN)/python -m tests.bench.fleet_pixels

soak: $(STAMP)
	$(BIN)/python -m tests.bench.soak

bench-coverage: $(STAMP)
	$(BIN)/python -m tests.bench.coverage
	$(BIN)/python -m tests.bench.calibration
	$(BIN)/python -m tests.bench.registration
	$(BIN)/python -m tests.bench.whole_chain

bench-diagnosis: $(STAMP)
	$(BIN)/python -m tests.bench.judged
	$(BIN)/python -m tests.bench.diagnosis

bench-grab: $(STAMP)
	$(BIN)/python -m tests.bench.grab --full
	$(BIN)/python -m tests.bench.grab_closed
	$(BIN)/python -m tests.bench.grab_emulated

clean:
	rm -rf $(VENV) build *.egg-info
