# Everything here works on a machine that has Python >= 3.11, make and a C library: the first target that needs it builds .venv.
PYTHON ?= python3
BIN = .venv/bin

# what Python has compiled is kept, whatever the shell says: without it each process of the tests takes 12 s more to start
export PYTHONDONTWRITEBYTECODE :=

.PHONY: demo test test-slow test-portable test-all test-oldest check site clean

demo: .venv/.ready
	$(BIN)/gonio demo --out demo-run

# a test is slow where it takes more than two seconds: campaigns, driver tests that wait, notebooks, the site
# Tests of a module run in one process: what they share, some of it a minute's work, is made once.
# Three on two processors: tests of drivers, pages and killed programs wait half of their time.
# Modules run in the order of tests/conftest.py, those with slow tests first.
PYTEST = $(BIN)/python -m pytest -q -n 3 --dist loadfile --no-loadscope-reorder
test: .venv/.ready
	$(PYTEST) -m "not slow and not portable"
	@echo "The slow tests were left out: make test-all runs every one."

test-slow: .venv/.ready
	$(PYTEST) -m slow

# on a Python without what one on Windows lacks: tests/portable/shim
test-portable: .venv/.ready
	$(PYTEST) -m portable tests/portable

# all in one run: tests are collected once, and no worker is idle at the end of a part
test-all: .venv/.ready
	$(PYTEST)

# the lowest versions that pyproject.toml allows; with the newest: make test-oldest CONSTRAINTS=
CONSTRAINTS = constraints-oldest.txt
test-oldest:
	$(PYTHON) -m venv --clear .venv-oldest
	.venv-oldest/bin/python -m pip install --quiet --disable-pip-version-check $(addprefix -c ,$(CONSTRAINTS)) -e '.[lab,workbooks,hdf5,parquet]' pytest hypothesis jsonschema mpmath
	.venv-oldest/bin/gonio demo --quick --out .venv-oldest/demo
	.venv-oldest/bin/python -m pytest -q tests/test_lower_bounds.py tests/gonio/test_config.py tests/gonio/test_measurement.py tests/gonio/formats tests/gonio_analysis/test_commands.py tests/gonio_scenes/test_render.py tests/gonio_drivers/test_bus.py tests/gonio_sim/test_rig.py

check: .venv/.ready
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# build/site/index.html: docs, notebooks and the API's reference; a warning or a dead link ends it
site: .venv/.ready
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --quiet --strict

.venv/.ready: pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(0 if sys.version_info >= (3, 11) else "gonio needs Python 3.11 or newer; say: make PYTHON=python3.11")'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	touch .venv/.ready

clean:
	rm -rf .venv .venv-oldest demo-run build
	find gonio drivers sim analysis tests -name __pycache__ -type d -exec rm -rf {} +
