.DELETE_ON_ERROR:
.DEFAULT_GOAL := help
PYTHON ?= python3
PIP := .venv/bin/python -m pip --quiet --disable-pip-version-check
# two processes: most of a test's time is compilation, which uses one core; the order of the files is conftest's
PYTEST := .venv/bin/python -m pytest --numprocesses 2 --dist loadfile --no-loadscope-reorder

.PHONY: help install demo test test-slow lint docs bench lock clean

help: ## this list
	@sed -n 's/^\([a-z-]*\):.*## /\1	/p' Makefile | expand -t 12

install: .venv/installed ## the locked versions and skyfit, editable, in .venv

.venv/installed: requirements.lock pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "skyfit needs Python 3.11 or newer")'
	$(PYTHON) -m venv .venv
	$(PIP) install --requirement requirements.lock
	$(PIP) install --no-deps --no-build-isolation --editable .
	@touch $@

demo: install ## the published sky refitted and the sample sky inverted, into demo/
	.venv/bin/skyfit refit --out demo/refit
	.venv/bin/skyfit invert data/skies/sample.nc --out demo/invert --free \
	  aerosol_optical_depth,angstrom_exponent,single_scattering_albedo,asymmetry,asymmetry_second,forward_fraction,ground_albedo,ozone

test: install ## the default tests; SLOW=1 takes the slow ones too; ARGS= goes to pytest
	$(PYTEST) $(if $(SLOW),-m '') $(ARGS)

test-slow: ## all tests, the slow ones too
	$(MAKE) test SLOW=1

.venv/linters: .venv/installed
	$(PIP) install --constraint requirements.lock --no-build-isolation --editable '.[dev]'
	@touch $@

lint: .venv/linters ## ruff and pyright
	.venv/bin/ruff check
	.venv/bin/ruff format --check
	.venv/bin/pyright

.venv/writers: .venv/installed
	$(PIP) install --constraint requirements.lock --no-build-isolation --editable '.[docs]'
	@touch $@

docs: .venv/writers ## the site of docs/ into build/docs/site: notebooks run, a broken link or a name without words fails
	NO_MKDOCS_2_WARNING=1 .venv/bin/python -m mkdocs build --strict --quiet --config-file docs/config/mkdocs.yml

.venv/rivals: .venv/installed
	$(PIP) install --constraint requirements.lock --no-build-isolation --editable '.[bench]'
	@touch $@

bench: .venv/rivals ## speed beside rivals, and what has become slower since the kept result
	mkdir -p build
	.venv/bin/python -m experiments.benchmarks.benchmark --out build/benchmark.json
	.venv/bin/python -m experiments.benchmarks.regressions build/benchmark.json

lock: ## requirements.lock anew: the newest versions that a clean environment takes
	rm -rf .venv/lock
	$(PYTHON) -m venv .venv/lock
	.venv/lock/bin/python -m pip --quiet --disable-pip-version-check install '.[test]'
	{ sed '/^[^#]/,$$d' requirements.lock; \
	  .venv/lock/bin/python -m pip --disable-pip-version-check freeze --exclude skyfit \
	  | grep -E '^[A-Za-z0-9._-]+=='; } > requirements.lock.new
	mv requirements.lock.new requirements.lock
	rm -rf .venv/lock

clean: ## removes what the other targets made
	rm -rf .venv demo dist build .pytest_cache .ruff_cache .hypothesis
