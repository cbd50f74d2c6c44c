# make run    set up .venv and run the paper's steerability sweep on the simulated rig
# make test   set up .venv, and run ruff and the tests that protect a user; some minutes
# make check  mypy, import-linter, deptry
# make test-slow   the other tests: kills, full disks, clusters, the wheel, the manual, a foreign CANopen client
# make test-random   the tests of properties with other examples, of the seed that is printed; the same again: SEED=N
# make test-processors   run tests with other kernels of numpy, OpenCV, BLAS and libm, and print how far numbers differ
# make mutants    change 200 places of steering, vision and record, and count what the tests notice; others: N=60 SEED=3
# make coverage   all tests with branch coverage
# make manual     build the manual as a site in .venv/manual/html; a link that leads nowhere fails
PYTHON ?= $(firstword $(foreach p,python3.11 python3.12 python3.13 python3,$(shell command -v $(p))))
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.labrig-ready
OUTSIDE := $(VENV)/outside-client
CLIENT := tests/devices/outside_client
ROOMS := vision needle steering protocol record analysis simulation cli/test_every_verb.py

.PHONY: run test check test-slow test-random check-rooms test-processors coverage mutants benchmarks manual clean
.DELETE_ON_ERROR:

run: $(READY)
	$(BIN)/labrig run protocols/steerability.yaml

# Tests start labrig some hundred times: it is compiled once, also where the environment forbids that. The tests of a file
# stay together: what they share, such as a sweep, is made once. Each process takes twelve seconds to collect all tests.
test: $(READY)
	$(BIN)/ruff check --quiet .
	$(BIN)/ruff format --check --quiet .
	PYTHONDONTWRITEBYTECODE= $(BIN)/pytest -n 2 --dist loadfile -m "not slow" $(COVERAGE)

check: $(READY)
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/deptry .

test-slow: $(READY) $(OUTSIDE)
	PYTHONDONTWRITEBYTECODE= $(BIN)/pytest -n 2 --dist loadfile -m slow $(COVERAGE)

test-random: SEED ?= $(shell date +%s)
test-random: $(READY)
	@echo "the seed of hypothesis is $(SEED)"
	$(BIN)/pytest -n 3 -m "hypothesis and not slow" --hypothesis-profile=random --hypothesis-seed=$(SEED)

# What another Python could change, without the tests that start processes or wait in real time: make check-rooms PYTHON=python3.13 VENV=.venv/newer
check-rooms: $(READY)
	$(BIN)/pytest -n 3 --dist loadfile -m "not slow" $(addprefix tests/,$(ROOMS))

test-processors: $(READY)
	PYTHONDONTWRITEBYTECODE= $(BIN)/python -m tests.processors

coverage: COVERAGE := --cov --cov-append --cov-report=term
coverage: test test-slow

manual: $(READY)
	$(BIN)/sphinx-build -q -W -b html labrig/manual $(VENV)/manual/html

# Hours, of which most are those of the changes that no test notices.
mutants: N ?= 200
mutants: SEED ?= 1
mutants: $(READY)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[mutation]'
	$(BIN)/python -m tests.mutants --sample $(N) --seed $(SEED)

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
