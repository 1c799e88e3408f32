# make demo | demo-fleet | demo-gateways | test | check | coverage | mutants | platforms | bench | accuracy | fuzz | faults | faults-long | kills |
# habits | machine-faults | fleet-faults | gateway-faults | limits – each sets itself up on a bare machine with Python 3.11
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
CASES ?= 12000
SEED ?=
# as many processes as processors are at work: threads of numpy's beside them only get in the way
export OPENBLAS_NUM_THREADS := 1
PART ?= 1/1

.PHONY: demo demo-fleet demo-gateways test check coverage mutants mutants-afresh platforms bench look accuracy fuzz faults faults-long habits kills machine-faults fleet-faults gateway-faults twins limits format lint types imports lock clean

demo: $(STAMP)
	$(BIN)/tworelay demo

# ends with 9: one of its axes is blocked
demo-fleet: $(STAMP)
	$(BIN)/tworelay demo --fleet; test $$? -eq 9

# what needs a punctual computer runs one at a time, after the rest
define TESTS
$(BIN)/python -m pytest -n auto --dist loadgroup -m "not real_time"
$(BIN)/python -m pytest -m real_time tests/job
endef

demo-gateways: $(STAMP)
	$(BIN)/tworelay demo --gateways

test: $(STAMP)
	$(TESTS)

check: $(STAMP)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/mypy --platform win32 --no-warn-unreachable -p commissioning -p drivers -p profiles
	$(BIN)/mypy --platform darwin --no-warn-unreachable -p commissioning -p drivers -p profiles
	$(BIN)/lint-imports
	$(TESTS)

# branches that no test takes, a module; what runs in other processes included
coverage: $(STAMP)
	rm -f .coverage .coverage.*
	$(BIN)/coverage run -m pytest -n auto --dist loadgroup -m "not real_time" --timeout 400 -q
	$(BIN)/coverage run -m pytest -m real_time -q tests/job
	$(BIN)/coverage combine -q
	$(BIN)/coverage report

# changes of the code that keeps people safe, each of which a test must notice; goes on for nine minutes where
# it ended; the last line is "mutants: N of M tried, K killed, L live"
mutants: $(STAMP)
	$(BIN)/python -m tests.mutants.campaign
mutants-afresh: $(STAMP)
	$(BIN)/python -m tests.mutants.campaign afresh

# the built wheel and sdist on every Python that is found; ends with "platforms: N rows, M held"
platforms: $(STAMP)
	$(BIN)/python -m tests.platforms

bench: $(STAMP)
	$(BIN)/python benchmarks/run.py

# the panel, the report at a desk, on a phone, in the dark and on paper: into look/, which is never committed
look: $(STAMP)
	$(BIN)/python benchmarks/look.py

# 40 random axes of each of 36 classes, and what they are measured with elsewhere; goes on for nine minutes where it
# ended, SEED: another draw; the last line is "accuracy: N of M axes"
accuracy: $(STAMP)
	SEED=$(SEED) $(BIN)/python benchmarks/accuracy.py

# fourteen targets: files of every kind, run folders, journals, links, and what peers send; 146 400 cases
fuzz: $(STAMP)
	TWORELAY_FUZZ=$(CASES) $(BIN)/python -m pytest tests/fuzz -n auto --timeout 1800

# a short job in which every transaction breaks once, in every way, on four wires; and 1 000 random ones a
# wire of the whole job; both end with "faults: N cases, M held"
faults: $(STAMP)
	$(BIN)/python -m tests.faults.every
faults-long: $(STAMP)
	$(BIN)/python -m tests.faults.every --long

# a job on a drive with each habit of real ones, on six links; ends with "habits: N cases, S survived, …"
habits: $(STAMP)
	$(BIN)/python -m tests.habits.campaign

# jobs that die at every step of their journal, in five ways; ends with "kills: N cases, M held"
kills: $(STAMP)
	$(BIN)/python -m tests.faults.kills

# fleet runs that break at every transition of their ledger, in seven ways, and buses that die; PART=1/2 and
# 2/2 are halves; ends with "fleet faults: N cases, M held"
fleet-faults: $(STAMP)
	$(BIN)/python -m tests.faults.fleet $(PART)

# gateways, clients, processes and wires fail in every way; make gateway-faults PART=2/4; ends with
# "gateway faults: N cases, M held"
gateway-faults: $(STAMP)
	$(BIN)/python -m tests.faults.gateways $(PART)

# the machine itself fails in every phase, in simulated time; ends with "machine faults: N cases, M held"
machine-faults: $(STAMP)
	$(BIN)/python -m tests.faults.machine

# 40 random axes of ten kinds are measured, and their twins again; ends with "twins: N axes, M held"
twins: $(STAMP)
	$(BIN)/python -m tests.twins.campaign

# random axes and settings in simulated time; ends with "limits: N axes, M held"
limits: $(STAMP)
	$(BIN)/python -m tests.faults.limits

format: $(STAMP)
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

lock: $(STAMP)
	$(BIN)/uv pip compile pyproject.toml --group dev --universal --generate-hashes --python-version 3.11 --output-file requirements.lock --no-header --no-annotate --quiet

$(STAMP): requirements.lock pyproject.toml
	$(PYTHON) -c "import sys; sys.exit(sys.version_info < (3, 11) and 'tworelay needs Python 3.11 or newer; set PYTHON=')"
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes --no-deps -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	touch $(STAMP)

clean:
	rm -rf $(VENV) dist build
