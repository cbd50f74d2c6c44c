# make run    set up .venv and run the paper's steerability sweep on the simulated rig
# make test   set up .venv and run every check
# make coverage   run the tests with branch coverage, which takes half as long again
PYTHON ?= $(firstword $(foreach p,python3.11 python3.12 python3.13 python3,$(shell command -v $(p))))
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.labrig-ready
OUTSIDE := $(VENV)/outside-client

.PHONY: run test check-code check-tests coverage benchmarks clean
.DELETE_ON_ERROR:

run: $(READY)
	$(BIN)/labrig run protocols/steerability.yaml

test: check-code check-tests

check-code: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/deptry .

check-tests: $(READY) $(OUTSIDE)
	$(BIN)/pytest -n 2 --dist worksteal $(COVERAGE)

coverage: COVERAGE := --cov --cov-report=term
coverage: check-tests

benchmarks: $(READY)
	$(BIN)/python -m tests.benchmarks

# A CANopen client that nobody here wrote; where node or the network is missing its test says so and is skipped.
$(OUTSIDE): | $(READY)
	@mkdir -p $(OUTSIDE)
	-@! command -v npm >/dev/null || npm install --silent --no-package-lock --no-audit --no-fund --fetch-retries=0 --fetch-timeout=20000 --prefix $(OUTSIDE) canopen@6.2.1

# The stamp is touched last, so that an installation cut short is done again.
$(READY): pyproject.toml constraints.txt
	@test -n "$(PYTHON)" || { echo "labrig needs Python 3.11 or newer: sudo apt install python3 python3-venv"; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "labrig needs Python 3.11 or newer, $(PYTHON) is older: sudo apt install python3.11 python3.11-venv"; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || { echo "Python's venv is missing: sudo apt install python3-venv"; exit 1; }
	$(PYTHON) -m venv --clear $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	@touch $@

clean:
	rm -rf $(VENV)
