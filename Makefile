# make run    set up .venv and run the paper's steerability sweep on the simulated rig
# make test   set up .venv and run every check
# make test-processors   run tests with other kernels of numpy, OpenCV, BLAS and libm, and print how far numbers differ
# make coverage   run the tests with branch coverage, which takes half as long again
# make manual     build the manual as a site in .venv/manual/html; a link that leads nowhere fails
PYTHON ?= $(firstword $(foreach p,python3.11 python3.12 python3.13 python3,$(shell command -v $(p))))
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.labrig-ready
OUTSIDE := $(VENV)/outside-client
CLIENT := tests/devices/outside_client
ROOMS := geometry vision needle steering protocol record analysis simulation campaign experiments runner

.PHONY: run test check-code check-tests check-rooms test-processors coverage benchmarks manual clean
.DELETE_ON_ERROR:

run: $(READY)
	$(BIN)/labrig run protocols/steerability.yaml

# The checks of the code keep one processor busy for half a minute; the tests begin beside them.
test: $(READY) $(OUTSIDE)
	@$(MAKE) --no-print-directory --jobs 2 check-code check-tests

check-code: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/deptry .

# Tests start labrig some hundred times: it is compiled once, also where the environment forbids that. Rehearsals and
# served drives wait in real time, so three processes keep two cores busy; a fourth one would slow the others down. The
# tests of a file stay together: what they share, such as a sweep, is made once.
check-tests: $(READY) $(OUTSIDE)
	PYTHONDONTWRITEBYTECODE= $(BIN)/pytest -n 3 --dist loadfile $(COVERAGE)

# What another Python could change, without the tests that start processes or wait in real time; CI runs it with a newer one.
check-rooms: $(READY)
	$(BIN)/pytest -n 3 --dist loadfile $(addprefix tests/,$(ROOMS))

test-processors: $(READY)
	PYTHONDONTWRITEBYTECODE= $(BIN)/python -m tests.processors

coverage: COVERAGE := --cov --cov-report=term
coverage: check-tests

manual: $(READY)
	$(BIN)/sphinx-build -q -W -b html labrig/manual $(VENV)/manual/html

benchmarks: $(READY)
	$(BIN)/python -m tests.benchmarks

# A CANopen client that nobody here wrote, each package with its SHA-512; where node or the network is missing its test
# says so and is skipped.
$(OUTSIDE): $(CLIENT)/package.json $(CLIENT)/package-lock.json | $(READY)
	@mkdir -p $(OUTSIDE)
	@cp $^ $(OUTSIDE)
	-@! command -v npm >/dev/null || npm ci --loglevel=error --no-audit --no-fund --fetch-retries=0 --fetch-timeout=20000 --prefix $(OUTSIDE)
	@touch $@

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
