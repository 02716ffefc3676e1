# Everything a fresh machine needs: `make demo` runs the main job, `make test` passes the tests.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PACKAGE := $(VENV)/package
STAMP := $(VENV)/installed
# A test that hangs fails after 20 minutes and tells where.
PYTEST := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --durations=15 --timeout=1200
# Python compiles at the first import: most files of the packages are never imported.
INSTALL := $(BIN)/python -m pip install --quiet --no-compile
# Where Python must not keep what it compiles, each process that a test starts compiles all anew.
unexport PYTHONDONTWRITEBYTECODE
SOURCES := pyproject.toml CMakeLists.txt $(shell find leglab/csrc rigs/csrc -type f)

.PHONY: demo test test-all soak sanitize lint docs results clean

demo: $(PACKAGE)
	$(BIN)/leglab report --scenario seal_wear --controllers pd,static_feedforward,bsnn_arx --out out/demo
	@echo "open out/demo/report.html"

# What turns red on a wrong formula, sign, contract or file: minutes.
test: $(STAMP)
	$(PYTEST) -m "not slow and not soak"

# All tests but soak: before an issue is resolved.
test-all: $(STAMP)
	$(PYTEST)

# Long cases of what the tests check with fewer samples.
soak: $(STAMP)
	$(PYTEST) -m soak --timeout=0

# The compiled core with AddressSanitizer and UndefinedBehaviourSanitizer, in build/sanitize.
sanitize: $(STAMP)
	$(BIN)/python -m tests.sanitize

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

docs: $(STAMP)
	rm -rf docs/reference/api/generated  # pages of modules that are gone
	$(BIN)/python -m sphinx -W --keep-going -n -q -j auto docs out/docs
	$(BIN)/python docs/_tools/check_links.py out/docs
	@echo "open out/docs/index.html"

# Hours: docs/data anew, then the tables of README.md and docs. Interrupted, the long ones go on.
# Minutes of each: .venv/bin/python -m benchmarks
results: $(STAMP)
	$(INSTALL) --group benchmarks
	$(BIN)/python -m benchmarks results

$(STAMP): $(PACKAGE)
	$(INSTALL) --group dev
	touch $@

$(PACKAGE): $(SOURCES)
	@$(PYTHON) -c 'import sys; assert sys.version_info >= (3, 11)' || { echo "leglab needs Python 3.11 or newer: make PYTHON=/path/to/python3.11"; exit 2; }
	@$(PYTHON) -c 'import ensurepip, venv' || { echo "Python's venv is missing: sudo apt-get install -y python3-venv"; exit 2; }
	@$(PYTHON) -c 'import os, sysconfig; assert os.path.exists(sysconfig.get_path("include") + "/Python.h")' || { echo "Python's headers are missing: sudo apt-get install -y python3-dev"; exit 2; }
	@command -v c++ > /dev/null || { echo "a C++ compiler is missing: sudo apt-get install -y g++"; exit 2; }
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(INSTALL) --upgrade 'pip>=25.1'
	$(INSTALL) --editable .
	touch $@

clean:
	rm -rf $(VENV) build out
