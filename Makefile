# What people and CI run. Each target sees to the system packages first (tools/setup, quick when nothing is missing).

CARGO ?= cargo
# Where the demo leaves its page, and more options of its training.
OUT ?= out/demo
DEMO_OPTIONS ?=
# Where the program and the library for C go.
PREFIX ?= /usr/local

# Which clusters the tests run on, of ray, slurm and kubernetes; all by default.
CLUSTERS ?=

# With which the tests of the networks' adapters run; it needs what tools/priors[test] names.
PYTHON ?= python3

# Builds for tests select everything. Packages then have the same features each time, and nothing compiles twice.
TEST_BUILD = --workspace --all-targets --locked

.PHONY: help demo test test-lanes test-python test-priors test-cluster container bench lint docs book check deny fuzz setup setup-tests install
.NOTPARALLEL:

help:
	@echo "make demo    synthesize a room, train it, write a page with renders and relit images beside the truth to $(OUT)"
	@echo "make test    formatting, lints and all tests"
	@echo "make test-lanes    the device tests again where lavapipe has 16 lanes"
	@echo "make test-python   the Python package, in a virtual environment under target"
	@echo "make test-priors   the adapters of networks; PYTHON=... must have torch and transformers"
	@echo "make test-cluster  twelve runs alone, on a Ray cluster and by Slurm on this machine: equal bits, though nodes and tasks die"
	@echo "make container     the image sgs:latest; needs podman, buildah or docker"
	@echo "make bench   time every pass and a whole step on this machine's device"
	@echo "make fuzz    feed every reader damaged files, in turns, until each has had an hour of the processor; stop it and go on at will"
	@echo "make lint    formatting, clippy, documentation and the crates' layers, without the other tests"
	@echo "make deny    licenses, duplicates, sources and security advisories of all packages; builds cargo-deny once"
	@echo "make docs    the API documentation, in target/doc"
	@echo "make book    the book of docs/, in target/book; builds mdbook once"
	@echo "make install put sgs with its manual and completions, libsgs, sgs.h and sgs.pc under PREFIX ($(PREFIX))"
	@echo "make setup   install or name missing system packages"

setup:
	@tools/setup

setup-tests:
	@tools/setup --tests

demo: setup
	$(CARGO) build --release --locked -p sgs
	DEMO_OPTIONS="$(DEMO_OPTIONS)" tools/demo "$${CARGO_TARGET_DIR:-target}/release/sgs" "$(OUT)"

# The tests include the layers, so this is lint and more.
test: setup-tests check
	python3 -B -m unittest discover -s tools/priors/tests -p 'test_[ps]*.py'
	$(CARGO) build $(TEST_BUILD)
	CARGO="$(CARGO)" tools/test

test-lanes: setup-tests
	$(CARGO) test --locked -p sgs-tests --tests --no-run
	SGS_TEST_LANES=all $(CARGO) test --locked -p sgs-tests --test lanes -- --nocapture

# Without PyTorch its tests are skipped.
test-python: setup
	-@tools/setup --python
	CARGO="$(CARGO)" BUILD="$(TEST_BUILD)" tools/python/test

test-priors:
	$(PYTHON) -c "import numpy, PIL, torch, torchvision, transformers"
	$(PYTHON) -B -m unittest discover -s tools/priors/tests

test-cluster: setup
	$(CARGO) build $(TEST_BUILD)
	tests/cluster/run $(CLUSTERS)

# The program must not need newer libraries than the image has: Debian 12.
container: setup
	$(CARGO) build --release --locked -p sgs
	tools/container/build "$${CARGO_TARGET_DIR:-target}/release/sgs"

lint: check
	$(CARGO) test --locked -p sgs-tests --test layers

check: setup
	tools/language
	$(CARGO) fmt --all --check
	$(CARGO) clippy --workspace --all-targets --locked -- -D warnings
	RUSTDOCFLAGS="-D warnings" $(CARGO) doc --workspace --no-deps --locked
	tools/deny --quick

# The test tests/tests/dependencies.rs checks the same lists on machines without cargo-deny.
deny: setup
	tools/deny

docs: setup
	$(CARGO) doc --workspace --no-deps --locked

# Also checks that every page is written and every link resolves. FILES=URL: where the repository's host shows files.
book: setup
	tools/book $(if $(FILES),--files "$(FILES)")

bench: setup
	$(CARGO) run --release --locked -p sgs-bench --bin engine-bench -- passes
	$(CARGO) run --release --locked -p sgs-bench --bin engine-bench -- step

fuzz: setup
	$(CARGO) --config tests/fuzz/coverage.toml run --profile fuzz --target "$$(rustc -vV | sed -n 's/^host: //p')" --locked -p sgs-fuzz -- --ledger tests/fuzz/ledger.toml --grown target/fuzz-grown --seconds 3600 --jobs "$$(nproc)"

install: setup
	$(CARGO) build --release --locked -p sgs -p sgs-capi
	tools/sgs/install "$(PREFIX)" "$${CARGO_TARGET_DIR:-target}/release/sgs"
	tools/capi/install "$(PREFIX)" "$${CARGO_TARGET_DIR:-target}/release"
