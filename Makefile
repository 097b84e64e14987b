# make demo    render a small scene, super-resolve it, look at it (demo/)
# make test    format, lint and tests, JOBS=2 files at once: what .ci/run runs
# make bench   the benchmark table
# make soak    2,000 frames: memory flat, quality steady (docs/soak.md); the service under load
#              (docs/load.md); chains of frames where pictures change (docs/changes.md)
# make quality the tables of quality; DEPTHSR_SCENES names the folder of the real scenes
# make report everything that `depthsr evaluate all` measures, on the same scenes (docs/measured.md)
# make learn   the learned filters anew, from photographs of scikit-image's package
# make peers   packages of other projects that `depthsr evaluate all` compares with (.peers/)
# make lint    format and lint alone
# make types   static types
# make lock    write the lock files anew (needs pip-tools)
# make clean   remove what the others made, the environment included

SHELL := /bin/bash
.DELETE_ON_ERROR:
.PHONY: demo test bench soak quality report learn peers lint types lock system clean

PYTHON ?= python3
JOBS ?= 2
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet
RUN := $(VENV)/.installed
DEV := $(VENV)/.installed-dev
PEERS := .peers/.installed
BTV_L1 := .peers/btv-l1

demo: $(RUN)
	$(BIN)/depthsr demo -o demo

test: $(DEV) $(PEERS) $(BTV_L1) system
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/python -m pytest --numprocesses $(JOBS) --dist loadfile --no-loadscope-reorder

bench: $(RUN)
	$(BIN)/python -m benchmarks
	$(BIN)/python -m benchmarks.video

soak: $(RUN)
	$(BIN)/python -m benchmarks.soak --write docs/soak.md
	$(BIN)/python -m benchmarks.service --write docs/load.md
	$(BIN)/python -m benchmarks.changes --write docs/changes.md

quality: $(RUN)
	$(BIN)/python -m benchmarks.quality

# Half an hour of one core; what other projects' networks and programs made is kept in report/peers.
REPORT_SCENES := lytro_2067 flower cones art kitti

report: $(RUN) $(PEERS) $(BTV_L1)
	$(BIN)/depthsr evaluate all $(addprefix $(DEPTHSR_SCENES)/,$(REPORT_SCENES)) sample \
		-o report --page docs/measured.md

# Its photographs alone are used: those that this version has in its package.
.learn/skimage: | $(RUN)
	$(PIP) install --no-deps --target .learn scikit-image==0.26.0

learn: $(RUN) .learn/skimage
	$(BIN)/python -m benchmarks.learn .learn/skimage/data

# Beside the environment, without their dependencies: those hold another OpenCV.
EXTRA := import tomllib; \
	print(*tomllib.load(open("pyproject.toml", "rb"))["project"]["optional-dependencies"]["peers"])

peers: $(PEERS) $(BTV_L1)

$(PEERS): pyproject.toml | $(RUN)
	$(PIP) install --no-deps --upgrade --target .peers $$($(BIN)/python -c '$(EXTRA)')
	@touch $@

# No Python package binds OpenCV's BTV-L1. Debian's headers come without opencv4.pc, unless all do.
$(BTV_L1): pipeline/evaluation/btv_l1.cpp
	@mkdir -p $(@D)
	@flags=$$(pkg-config --cflags opencv4 2>/dev/null || echo -I/usr/include/opencv4); \
	{ echo '#include <opencv2/superres.hpp>' | $(CXX) $$flags -E -x c++ - >/dev/null 2>&1 && \
		$(CXX) -O2 $$flags $< -o $@ $$(pkg-config --libs-only-L opencv4 2>/dev/null) \
			-lopencv_superres -lopencv_core; } || \
	{ rm -f $@; echo "BTV-L1 is left out: it takes a C++ compiler and the headers of OpenCV's" \
		"superres (Debian: libopencv-superres-dev)"; }

lint: $(DEV)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(DEV)
	$(BIN)/mypy

# The environment: locked dependencies by hash, then the package itself, in place.
$(BIN)/python:
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed")'
	$(PYTHON) -m venv $(VENV)

$(RUN): requirements.lock pyproject.toml | $(BIN)/python
	$(PIP) install --require-hashes -r requirements.lock
	$(PIP) install --no-deps --no-build-isolation --editable .
	$(BIN)/python -m compileall -q pipeline service dscqs  # where Python may keep no byte code, too
	@touch $@

$(DEV): requirements-dev.lock $(RUN)
	$(PIP) install --require-hashes -r requirements-dev.lock
	@touch $@

# What the tests ask for a second opinion: players and probes of other projects, a real browser,
# cameras that speak RTSP (GStreamer's server, by the system's Python).
SYSTEM_TOOLS := ffprobe chromium mpv mediainfo
SYSTEM_PACKAGES := ffmpeg chromium mpv mediainfo fonts-dejavu-core fonts-noto-cjk \
	gir1.2-gst-rtsp-server-1.0 gstreamer1.0-plugins-good gstreamer1.0-plugins-bad python3-gi
RTSP_SERVER := /usr/bin/python3 -c "import gi; gi.require_version('GstRtspServer', '1.0')"

system:
	@missing=""; for tool in $(SYSTEM_TOOLS); do \
		command -v $$tool >/dev/null || missing="$$missing $$tool"; \
	done; \
	$(RTSP_SERVER) 2>/dev/null || missing="$$missing rtsp-server"; \
	if [ -z "$$missing" ]; then :; \
	elif [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
		apt-get update -qq && DEBIAN_FRONTEND=noninteractive \
			apt-get install -y -qq --no-install-recommends $(SYSTEM_PACKAGES) >/dev/null; \
	else echo "missing:$$missing (packages $(SYSTEM_PACKAGES)): tests that need them are skipped"; fi

lock:
	for extra in "" "-dev"; do \
		$(BIN)/pip-compile --quiet --generate-hashes --allow-unsafe --strip-extras --no-header \
			--no-emit-index-url --no-emit-find-links --all-build-deps \
			$${extra:+--extra dev} -o requirements$$extra.lock pyproject.toml || exit 1; \
	done

clean:
	rm -rf $(VENV) .peers demo build *.egg-info .pytest_cache .ruff_cache .mypy_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
