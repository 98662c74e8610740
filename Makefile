# Everything runs in .venv, which is made on first use from environment.txt.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
TESTED := $(VENV)/.tested
# The executed notebooks and the tests never need the network.
export PIP_DISABLE_PIP_VERSION_CHECK := 1
# Two processes of tests whose linear algebra has two threads each wait for one another: a calibration
# takes ten times as long then. No matrix here is large enough for a second thread.
export OPENBLAS_NUM_THREADS := 1
# Without assertions and docstrings neither tests nor pages are whole.
unexport PYTHONOPTIMIZE
# Packages are compiled as they are first used; pip would compile all, which takes half a minute.
export PYTHONDONTWRITEBYTECODE :=

# What pip wrote into .venv names its folder; the stamp says which that was.
MADE_IN := $(shell cat $(STAMP) 2>/dev/null)
ifneq ($(MADE_IN),$(if $(MADE_IN),$(CURDIR)))
$(info This folder was moved from $(MADE_IN); make sets up .venv anew)
$(shell rm -rf $(VENV))
endif

.DEFAULT_GOAL := help
.PHONY: help setup extras lab book pdf test notebooks html lint format data benchmarks oldest newest portable hostile unused lock clean

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z]+:.*## / {printf "  make %-12s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup: $(STAMP) ## make .venv with the locked packages and microlib

$(STAMP): environment.txt pyproject.toml
	@echo "Setting up $(VENV) (about a minute, once)"
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed")'
	@$(PYTHON) -m venv $(VENV)
	@$(BIN)/pip install --quiet --no-compile --no-deps --require-hashes -r environment.txt
	@$(BIN)/pip install --quiet --no-deps --no-build-isolation -e .
	@echo "$(CURDIR)" > $@

# What the tests, the checks of style and the printing of the book add to environment.txt.
$(TESTED): test.txt $(STAMP)
	@echo "Installing what the tests need (half a minute, once)"
	@$(BIN)/pip install --quiet --no-compile --no-deps --require-hashes -r test.txt
	@touch $@

# Installed over environment.txt, whose versions extras.txt keeps to. Both name all that is needed; pip
# would not find the hash of a package that one of them wants with an extra.
extras: $(STAMP) ## install pymmcore-plus, dask and zarr into .venv; their tests are skipped without them
	@$(BIN)/pip install --quiet --no-compile --no-deps --require-hashes -r extras.txt

lab: $(STAMP) ## install JupyterLab into .venv and open the notebooks
	@$(BIN)/pip install --quiet --no-compile --no-deps --require-hashes -r lab.txt
	@$(BIN)/python -m jupyterlab $(if $(filter 0,$(shell id -u)),--allow-root) notebooks

notebooks: $(STAMP) ## run the notebooks that changed
	@echo "Running the notebooks that changed (all of them take three minutes on two cores)"
	@$(BIN)/python -m compendium.run

# What fails stops nothing else: it is listed at the end, and make ends with its exit status.
html: $(STAMP)
	@echo "Running the notebooks that changed (all of them take three minutes on two cores)"
	@trap 'exit 130' INT; $(BIN)/python -m compendium.run || true; $(BIN)/python -m compendium.book

book: html ## run the notebooks and build the book
	@echo "The book is at build/html/index.html"

pdf: html $(TESTED) ## print the book to build/book.pdf (needs a Chromium)
	@$(BIN)/python book/make_pdf.py
	@echo "The book is in build/book.pdf, its summary in build/summary.pdf"

test: $(TESTED) ## run every test: library, notebooks, book
	@trap 'exit 130' INT; failed=0; \
	$(MAKE) --no-print-directory --keep-going --jobs 2 html lint || failed=1; \
	$(BIN)/python -m pytest --numprocesses 2 --quiet || failed=1; \
	$(BIN)/python -m compendium.run --failures && exit $$failed

lint: $(TESTED) ## check format, style and types, and that the notebooks have no outputs
	@$(BIN)/ruff format --check --quiet .
	@$(BIN)/ruff check --quiet .
	@nice $(BIN)/mypy # in `make test` the notebooks, which take longer, run beside it
	@$(BIN)/nbstripout --keep-id --verify notebooks/*.ipynb

format: $(TESTED) ## format the code and strip the notebooks
	@$(BIN)/ruff format .
	@$(BIN)/ruff check --fix .
	@$(BIN)/nbstripout --keep-id notebooks/*.ipynb

data: $(STAMP) ## write the files of data/synthetic again, byte-identical
	@$(BIN)/python -m data.synthetic.make

benchmarks: $(STAMP) ## compare microlib with other tools (about an hour; prints the time, keeps finished results)
	@$(BIN)/python -m benchmarks

# The library's tests; the others need what runs and renders the book.
LIBRARY ?= tests $(foreach name,book notebooks compendium,--ignore tests/$(name))

oldest: ## run the library's tests with the oldest dependencies that pyproject.toml allows
	@$(PYTHON) -m venv --clear .venv-oldest
	@.venv-oldest/bin/pip install --quiet --requirement tests/oldest.txt .
	@.venv-oldest/bin/python -m pytest --numprocesses 2 --quiet $(LIBRARY)

newest: ## run the library's tests with the newest dependencies; PYTHON=python3.13 selects the Python
	@$(PYTHON) -m venv --clear .venv-newest
	@.venv-newest/bin/pip install --quiet --upgrade .[codecs,opencv] $$(sed -n '/^hypothesis/,$$s/==.*//p' tests/oldest.txt)
	@.venv-newest/bin/python -m pytest --numprocesses 2 --quiet $(LIBRARY)

portable: $(TESTED) ## run everything with the rounding of other processors (about an hour)
	@$(BIN)/python .ci/portable.py $(PORTABLE)

hostile: $(TESTED) ## run notebooks in a fresh clone under faults of other machines, such as a full disk (minutes)
	@$(BIN)/python .ci/hostile.py $(HOSTILE)

unused: $(TESTED) ## list the lines of microlib that no notebook and no command runs (minutes)
	@$(BIN)/python .ci/unused.py

# Nothing is read from S3, whose client that agrees with the other versions is ten years old and
# hinders imports.
UNUSED := s3fs boto3 botocore bcdoc jmespath six

COMPILE := uv pip compile pyproject.toml --generate-hashes --universal --python-version 3.11 \
  --no-header --no-annotate --quiet
# The packages that environment.txt has, when it is written.
OMIT = $$(sed -n 's/^\([A-Za-z0-9._-]*\)==.*/--no-emit-package \1/p' environment.txt)

lock: $(STAMP) ## update the versions in environment.txt, test.txt, extras.txt and lab.txt (needs uv)
	@$(COMPILE) --extra book -o environment.txt
	@$(COMPILE) --extra book --extra test --constraints environment.txt $(OMIT) -o test.txt
	@$(COMPILE) --extra dask --extra microscope --constraints environment.txt \
	  $(addprefix --no-emit-package ,$(UNUSED)) -o extras.txt
	@$(COMPILE) --extra lab --constraints environment.txt -o lab.txt

clean: ## remove what was built
	@rm -rf build book/notebooks book/generated .venv-oldest .venv-newest
