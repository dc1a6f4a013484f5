# Needs Python 3.10 or later and make. `make PYTHON=python3.12 VENV=/tmp/venv test` chooses others.
PYTHON ?= python3
VENV ?= .venv
SUDO ?=
JOBS ?= 2

BIN := $(VENV)/bin
# The warning is setuptools' own, of every project whose folders have other names than its packages.
PIP := PYTHONWARNINGS='ignore:Editable installation' $(BIN)/python -m pip --disable-pip-version-check -q
SYSTEM := libusb-1.0-0 libegl1 libgl1 libx11-6 libudev1 libidn2-0 libgomp1
PACKAGING := pyproject.toml

.DEFAULT_GOAL := help
.PHONY: help demo test test-viewer test-ros2 test-dora lint docs package clean bench-topology \
  bench-speed bench-stream bench-stream-live

help:
	@echo 'make demo            set up, and run the main job on a cloud of its own: out/demo'
	@echo 'make test            set up, and run every check'
	@echo 'make test-viewer     set up, and try the live page in a real browser'
	@echo 'make test-ros2       the ROS 2 node, in an environment of its own'
	@echo 'make test-dora       dora dataflows, in an environment of their own'
	@echo 'make lint            the checks without the tests'
	@echo 'make docs            build the documentation: build/site'
	@echo 'make package         build wheel and sdist, and use them under every Python there is'
	@echo 'make bench-topology  all of the topology benchmark (hours)'
	@echo 'make bench-stream    all that streaming must show, but for the live run (5 minutes)'
	@echo 'make bench-stream-live   30,000 points at 10 Hz for 5 minutes'
	@echo 'make bench-speed     the speed benchmark (10 minutes)'
	@echo 'make clean           remove what was set up and made'

demo: $(VENV)/.demo
	$(BIN)/mdcs demo -o out/demo

test: lint
	$(BIN)/mdcs warmup  # once, not in every process of the suite
	$(BIN)/python -m pytest -n $(JOBS) --cov --cov-branch --cov-report=term --cov-fail-under=90

test-viewer: $(VENV)/.viewer
	$(BIN)/python -m pytest tests/test_viewer_parts.py tests/test_viewer_page.py \
	  tests/test_viewer_browser.py

# Its wheels start each Python of their environment anew, so it is none of ours.
test-ros2: $(VENV)-ros2/.ros2
	$(VENV)-ros2/bin/mdcs warmup
	$(VENV)-ros2/bin/python -m pytest tests/ros2 tests/test_nodes.py

test-dora: $(VENV)-dora/.dora
	$(VENV)-dora/bin/mdcs warmup
	$(VENV)-dora/bin/python -m pytest tests/dataflow

lint: $(VENV)/.test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

docs: $(VENV)/.test
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict

package: $(VENV)/.test
	$(BIN)/python tests/package_check.py --jobs $(JOBS)

bench-topology: $(VENV)/.test
	$(BIN)/python -m benchmarks.topology --suites '.*' --seeds 3 --jobs $(JOBS) \
	  --method mdcs:default --method mdcs:paper --sheet build/failures.png --readme

bench-stream: $(VENV)/.test
	$(BIN)/python -m benchmarks.stream --readme

bench-stream-live: $(VENV)/.test
	$(BIN)/python -m benchmarks.stream --parts live --readme

bench-speed: $(VENV)/.test
	$(BIN)/python -m benchmarks.speed --readme

clean:
	rm -rf .venv .venv-ros2 .venv-dora build dist out docs/figures *.egg-info .coverage .coverage.* \
	  .pytest_cache .mypy_cache .ruff_cache \
	  .hypothesis .import_linter_cache
	find mdcs_pipeline nodes configs tests benchmarks -name __pycache__ -prune -exec rm -rf {} +

# The interpreter is tried first: an old one fails in pip with a message that names nothing.
$(VENV)/.venv:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10))' || { \
	  echo "make: $(PYTHON) is missing or older than 3.10; name another: make PYTHON=python3.12" >&2; \
	  exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || { \
	  v=$$($(PYTHON) -c 'import sys; print("%d.%d" % sys.version_info[:2])'); \
	  echo "make: $(PYTHON) cannot make environments; run: apt-get install python$$v-venv" >&2; \
	  exit 1; }
	rm -rf $(VENV)
	$(PYTHON) -m venv $(VENV)
	$(PIP) install --upgrade pip
	@touch $@

$(VENV)-ros2/.ros2 $(VENV)-dora/.dora: $(PACKAGING)
	$(MAKE) VENV=$(@D) $(@D)/.venv
	$(@D)/bin/python -m pip --disable-pip-version-check -q install -e '.[$(patsubst .%,%,$(@F)),test]'
	@touch $@

$(VENV)/.demo: $(PACKAGING) | $(VENV)/.venv
	$(PIP) install -e '.[open3d-cpu,draw]'
	@$(open3d-libraries)
	@touch $@

$(VENV)/.test: $(PACKAGING) | $(VENV)/.venv
	$(PIP) install -e '.[open3d-cpu,draw,bags,docs,test]'
	@$(open3d-libraries)
	@touch $@ $(VENV)/.demo

# Without Open3D: the page needs none, and its wheel alone is larger than all of this.
$(VENV)/.viewer: $(PACKAGING) | $(VENV)/.venv
	$(PIP) install -e '.[viewer,browser,test]'
	@$(chromium)
	@touch $@

# The system's browser: the one that playwright would fetch comes from outside of PyPI.
define chromium
found() { command -v chromium || command -v chromium-browser; }; \
if ! found >/dev/null; then \
  if command -v apt-get >/dev/null && { [ "$$(id -u)" = 0 ] || [ -n "$(SUDO)" ]; }; then \
    echo "installing chromium"; \
    $(SUDO) apt-get -qq update && \
    DEBIAN_FRONTEND=noninteractive $(SUDO) apt-get -qq install -y --no-install-recommends chromium >/dev/null; \
  fi; \
  found >/dev/null || { \
    echo "make: no chromium; as root run: apt-get update && apt-get install -y chromium" >&2; \
    exit 1; }; \
fi
endef

# Open3D's wheel leaves these to the system; which are missing shows when it is imported.
define open3d-libraries
if ! why=$$($(BIN)/python -c 'import open3d' 2>&1); then \
  if command -v apt-get >/dev/null && { [ "$$(id -u)" = 0 ] || [ -n "$(SUDO)" ]; }; then \
    echo "installing the system libraries of Open3D: $(SYSTEM)"; \
    $(SUDO) apt-get -qq update && \
    DEBIAN_FRONTEND=noninteractive $(SUDO) apt-get -qq install -y --no-install-recommends $(SYSTEM) >/dev/null; \
  fi; \
  $(BIN)/python -c 'import open3d' 2>/dev/null || { \
    echo "$$why" | tail -n 1 >&2; \
    echo "make: Open3D lacks system libraries; as root run:" >&2; \
    echo "  apt-get update && apt-get install -y $(SYSTEM)" >&2; \
    exit 1; }; \
fi
endef
