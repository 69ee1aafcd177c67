# `make demo` and `make test` need nothing but Python 3.11 or newer; uv is used when it is there.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
UV := $(shell command -v uv 2>/dev/null)

ifdef UV
CREATE = uv venv --quiet --python $(PYTHON) $(VENV)
INSTALL = uv pip install --quiet --python $(BIN)/python
WHEEL = uv build --quiet --wheel --out-dir dist && \
	uv venv --quiet --clear --python $(PYTHON) $(VENV)/bare && \
	uv pip install --quiet --python $(VENV)/bare/bin/python dist/imucalib-*.whl
else
CREATE = $(PYTHON) -m venv $(VENV)
INSTALL = $(BIN)/python -m pip install --quiet --disable-pip-version-check
WHEEL = $(PYTHON) -m venv --clear $(VENV)/bare && \
	$(VENV)/bare/bin/python -m pip wheel --quiet --disable-pip-version-check --no-deps -w dist . && \
	$(VENV)/bare/bin/python -m pip install --quiet --disable-pip-version-check dist/imucalib-*.whl
endif

.PHONY: site demo test test-slow test-oldest check wheel docs benchmark loop-benchmark stories benchmark-worn benchmark-array fuzz clean

$(BIN)/imucal: pyproject.toml
	test -x $(BIN)/python || $(CREATE)
	$(INSTALL) -e .
	@touch $@

$(VENV)/.dev: pyproject.toml $(BIN)/imucal
	$(INSTALL) -e '.[dev]'
	@touch $@

demo: $(BIN)/imucal ## calibrate the sample logs: errors before and after, and where the reports are
	@$(BIN)/python sample_logs/demo.py $(BIN)/imucal demo

test: $(VENV)/.dev ## run the tests, but for those that are marked slow
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n auto

test-slow: $(VENV)/.dev ## run the tests that `make test` leaves out
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n auto -m slow

check: $(VENV)/.dev ## style, types and generated pages, as CI runs them
	$(BIN)/ruff check src tests benchmarks sample_logs docs
	$(BIN)/ruff format --check src tests benchmarks sample_logs docs
	$(BIN)/mypy
	$(BIN)/python docs/generate.py --check

wheel: ## the wheel without extras, in an environment of its own, runs the core commands
	rm -rf dist
	$(WHEEL)
	.ci/wheel $(VENV)/bare

docs: $(VENV)/.dev ## write the pages that are generated from the code, and the outputs that pages show
	$(BIN)/python docs/generate.py --outputs
	command -v chromium >/dev/null && $(BIN)/python docs/picture.py || true

$(VENV)/.site: pyproject.toml $(BIN)/imucal
	$(INSTALL) -e '.[docs]'
	@touch $@

site: $(VENV)/.site ## the documentation as a site in site/; a link that leads nowhere is an error
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --site-dir site

benchmark: $(VENV)/.dev ## measure the marks of docs/lab.md on simulated benches and on real data
	OPENBLAS_NUM_THREADS=1 $(BIN)/python benchmarks/lab/benches.py

benchmark-worn: $(VENV)/.dev ## measure actigraph beside its peers, on generated days and weeks
	$(BIN)/python benchmarks/actigraph/peers.py
	$(BIN)/python benchmarks/cost.py --write

benchmark-array: $(VENV)/.dev ## measure the array's reading of long logs
	$(BIN)/python benchmarks/array/log.py

fuzz: $(VENV)/.dev ## damage files of every format, compare what is read with what was written; FILES=300, SEED=1
	$(BIN)/python benchmarks/readers/fuzz --files $(or $(FILES),3000) --seed $(or $(SEED),0)

loop-benchmark: $(VENV)/.dev ## the acceptance benchmark of the closed loop; COUNT=20 for a quick look, SEED=1
	$(BIN)/python benchmarks/closed_loop bench norm worn --count $(or $(COUNT),200) --seed $(or $(SEED),1) --jobs 2
	$(BIN)/python benchmarks/closed_loop/array_jobs.py --scale $(or $(SCALE),0.1)

stories: $(VENV)/.dev ## run the command on recorded data and write docs/closed_loop.md's stories
	$(BIN)/python docs/stories.py

test-oldest: ## run the tests on the oldest versions of the dependencies that pyproject.toml states
	$(PYTHON) -m venv --clear $(VENV)/oldest
	$(PYTHON) tests/oldest.py > $(VENV)/oldest.txt
	$(VENV)/oldest/bin/python -m pip install --quiet --disable-pip-version-check -c $(VENV)/oldest.txt -e '.[dev]'
	OPENBLAS_NUM_THREADS=1 $(VENV)/oldest/bin/python -m pytest -n auto

clean:
	rm -rf $(VENV) demo dist site .pytest_cache .mypy_cache .ruff_cache
