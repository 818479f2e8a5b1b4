# `make` sets up .venv, then makes and verifies the whole print set in stl_out/. `make test` runs the tests.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Processes that the tests are spread over. Each begins with a stretch of its own, so that what a module's tests share is made once.
JOBS ?= auto
SPREAD := -n $(JOBS) --dist worksteal
# Small matrix products on many threads get in the way of tests side by side.
export OPENBLAS_NUM_THREADS ?= 1

.PHONY: all test test-fast test-real test-long lint docs bench clean system-libraries
all: $(VENV)/.user
	$(BIN)/tacbench make

# Everything that needs nothing but our own code.
test: $(VENV)/.dev
	$(BIN)/python -m pytest $(SPREAD) --ignore tests/real

# The core alone: formulas, blocks, meshes, file formats; below a minute.
test-fast: $(VENV)/.dev
	$(BIN)/python -m pytest $(SPREAD) tests/util tests/spec tests/formats tests/geometry/meshing tests/geometry/splines tests/geometry/test_block_mesh.py

# Other people's programs on our files, the packages installed into empty environments, and the manual.
test-real: $(VENV)/.dev
	$(BIN)/python -m pytest $(SPREAD) tests/real

# The full counts of all of them.
test-long: $(VENV)/.dev
	$(BIN)/python -m pytest $(SPREAD) --long

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# The manual. The code in its pages is run first, which renews the outputs and pictures that stand in them; a warning of the build is an error.
docs: $(VENV)/.docs
	$(BIN)/python docs/renew.py
	$(BIN)/sphinx-build -E -W --keep-going -n -j auto docs docs/_build/html

bench: $(VENV)/.bench
	set -e; for script in startup stl_speed make_time mesh_triangles solid tactip press_loop press_time run_folders simulate_study paper_protocol accuracy_intervals contact_in_engines slice_check design_page watch_page; do $(BIN)/python benchmarks/$$script.py; done

clean:
	rm -rf $(VENV) build *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis

$(VENV)/.user: EXTRA := all
$(VENV)/.dev: EXTRA := dev
$(VENV)/.docs: EXTRA := docs
$(VENV)/.bench: EXTRA := bench
$(VENV)/.user $(VENV)/.dev $(VENV)/.docs $(VENV)/.bench: pyproject.toml constraints.txt | system-libraries $(BIN)/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[$(EXTRA)]'
	$(BIN)/tacbench doctor --repair || echo "going on with what works; see the lines above"
	touch $@

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "error: $(PYTHON) is older than Python 3.11; name another with make PYTHON=python3.12"; exit 2; }
	$(PYTHON) -m venv $(VENV)

# The CAD kernel needs two libraries that a bare server lacks: installed where that is allowed, else named.
system-libraries:
	@if command -v ldconfig >/dev/null && ! { ldconfig -p | grep -q 'libGL\.so\.1' && ldconfig -p | grep -q 'libX11\.so\.6'; }; then \
	  if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then apt-get update -qq && apt-get install -y -qq libgl1 libx11-6; \
	  else echo "libGL.so.1 or libX11.so.6 is missing; run: sudo apt-get install -y libgl1 libx11-6"; fi; fi
