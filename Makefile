# Every target sets up what it needs. `make` alone lists them.
SHELL  := /bin/bash
PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed
PROJECTS := pyproject.toml server/pyproject.toml worker/pyproject.toml
T      ?= tests
N      ?= $(shell expr $$(nproc 2>/dev/null || echo 1) + 1)
PORT   ?= 8000
DATA   ?= ./data
SECONDS_OF_FUZZ ?= 600
UPGRADE ?= --upgrade
LOCKS  ?= bootstrap dev
# A hundred processes start in the tests: each would compile every module anew where images forbid bytecode.
export PYTHONDONTWRITEBYTECODE :=
# WHEELHOUSE=folder: every target installs from a folder that `make wheelhouse` filled, and asks no network.
ifdef WHEELHOUSE
export PIP_NO_INDEX := 1
export PIP_FIND_LINKS := $(abspath $(WHEELHOUSE))
export UV_OFFLINE := 1
export UV_NO_INDEX := 1
export UV_FIND_LINKS := $(abspath $(WHEELHOUSE))
endif
.DEFAULT_GOAL := help

help:  ## list the targets
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 14

# uv installs the same hashed lock about three times faster; where it cannot reach a registry, pip does it.
$(STAMP): requirements/dev.txt requirements/bootstrap.txt $(PROJECTS)
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@echo "setting up $(VENV) (about half a minute, once)"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements/bootstrap.txt
	@$(BIN)/uv pip install --quiet --python $(BIN)/python --require-hashes -r requirements/dev.txt 2>$(VENV)/uv.log \
	  || { echo "uv could not install (see $(VENV)/uv.log); taking pip"; \
	       $(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements/dev.txt; }
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e . -e server -e worker
	@touch $@

setup: $(STAMP)  ## install everything into $(VENV)

# The wheel of the client, which the server hands to participants; `make wheelhouse LOCKS=client` beside it makes it whole.
CLIENT := $(VENV)/client
$(CLIENT)/.built: $(STAMP) $(shell find client schemas worker/exceptiondrive_scoring -type f -not -name '*.pyc')
	@rm -f $(CLIENT)/exceptiondrive-*.whl
	@$(BIN)/python -m hatchling build -t wheel -d $(abspath $(CLIENT)) >/dev/null
	@touch $@

run: $(STAMP) $(CLIENT)/.built  ## API, worker, broker and page at http://127.0.0.1:$(PORT); Ctrl-C ends all
	@PATH="$(abspath $(BIN)):$$PATH" EXCEPTIONDRIVE_CLIENT_DIR="$${EXCEPTIONDRIVE_CLIENT_DIR:-$(abspath $(CLIENT))}" \
	  exec $(BIN)/exceptiondrive-server run --port $(PORT) --data $(DATA) --sample

# Page and proxy are tested in a real browser and a real nginx where they are or can be installed; elsewhere those tests skip and say so.
$(VENV)/.system: $(STAMP) tests/install-system-parts
	@tests/install-system-parts $(VENV)/system.log
	@touch $@

test: $(STAMP) $(VENV)/.system  ## all tests; T=path picks some, N=2 says how many processes
	$(BIN)/python -m pytest -n $(N) --dist loadfile --no-loadscope-reorder $(T)

pythons: $(STAMP)  ## the tests of client, scoring and worker on every other Python found, 3.10 to 3.14; T=path picks some, ENDS=1 the client's on the oldest and newest
	$(BIN)/python -m tests.on_every_python $(if $(ENDS),--ends) $(filter-out tests,$(T))

bench: $(STAMP)  ## the figures of docs/performance.md in one run, and at its end what was asked beside what was measured
	$(BIN)/python -m benchmarks

chaos: $(STAMP)  ## inject every fault of docs/faults.md into real processes; F="F01 F24" picks some, RESUME=1 goes on, WITHOUT=1 takes injections out
	$(BIN)/python -m tests.chaos $(if $(RESUME),--resume) $(if $(WITHOUT),--without) $(F)

fuzz: $(STAMP)  ## change submission files by coverage until the two readers differ; SECONDS_OF_FUZZ=600, kept in .fuzz/
	@mkdir -p .fuzz
	$(BIN)/python -m tests.fuzz.harness -max_total_time=$(SECONDS_OF_FUZZ) -artifact_prefix=.fuzz/ .fuzz

protections: $(STAMP)  ## take each protection of docs/trust.md away and see its test fail; P="csrf scope" picks some
	$(BIN)/python -m tests.protections $(P)

load: $(STAMP)  ## a deadline rush: hundreds of uploads within minutes, while the board is read
	$(BIN)/python -m benchmarks.load

pictures: $(STAMP) $(VENV)/.system  ## take the pictures of the README anew, of the sample board, in light and dark
	$(BIN)/python docs/pictures/take.py

# Another PYTHON, or the same on another machine, adds what it needs to the same folder.
wheelhouse:  ## download every hashed wheel of LOCKS="bootstrap dev" (or client), and build our own, into ./wheelhouse
	$(PYTHON) -m venv $(VENV)-wheelhouse
	for lock in $(LOCKS); do \
	  $(VENV)-wheelhouse/bin/python -m pip download --quiet --disable-pip-version-check --no-deps --require-hashes \
	    -r requirements/$$lock.txt -d wheelhouse || exit 1; done
	$(VENV)-wheelhouse/bin/python -m pip wheel --quiet --disable-pip-version-check --no-deps -w wheelhouse . $(if $(filter-out client,$(LOCKS)),./server ./worker)
	rm -r $(VENV)-wheelhouse
	@du -sh wheelhouse; ls wheelhouse | wc -l

lint: $(STAMP)  ## format, lint, types, import contracts, the oldest Python of each part
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/djhtml --tabwidth 2 --check server worker
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/vermin --quiet --no-tips --violations --eval-annotations --exclude-regex '/python310\.py$$' -t=3.10- client schemas worker/exceptiondrive_scoring \
	  tests/client tests/schemas tests/scoring tests/agent
	$(BIN)/vermin --quiet --no-tips --violations -t=3.6- client/exceptiondrive/recorder.py

format: $(STAMP)  ## rewrite code and templates in the project's format
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .
	$(BIN)/djhtml --tabwidth 2 server worker

LOCK = $(BIN)/uv pip compile --quiet --universal --generate-hashes --no-header --no-emit-index-url --no-emit-find-links \
  --no-emit-package exceptiondrive --no-emit-package exceptiondrive-server
lock: $(STAMP)  ## renew the hashed locks (UPGRADE= keeps the versions); they carry no addresses
	$(LOCK) $(UPGRADE) --python-version 3.11 --all-extras --group dev -o requirements/dev.txt $(PROJECTS)
	grep -A 100 '^uv==' requirements/dev.txt | awk 'NR==1 || /^ /{print; next} {exit}' | sed '/# via/d' > requirements/bootstrap.txt
	$(LOCK) --python-version 3.11 --extra server -c requirements/dev.txt -o requirements/server.txt server/pyproject.toml
	$(LOCK) --python-version 3.11 -c requirements/dev.txt -o requirements/worker.txt worker/pyproject.toml
	$(LOCK) $(UPGRADE) --python-version 3.10 --all-extras -o requirements/client.txt pyproject.toml
	! grep -nE '://|--(extra-)?index-url|--find-links' requirements/*.txt

.PHONY: help setup run wheelhouse test pythons chaos fuzz protections load bench pictures lint format lock
