# The verbs of this repository. `make` alone prints them; each installs what it misses.
SHELL := /bin/bash
.DEFAULT_GOAL := help
VENV := .venv
PYTEST := $(VENV)/bin/pytest
# Two files at once, each beside a stack of its own; those that take long first (tests/conftest.py).
BY_FILE := -n 2 --dist loadfile --no-loadscope-reorder
# A test that hangs ends its worker: a page that waits for ever hears nothing gentler. Before it the traceback of each
# thread goes to the log, since what a worker writes at its end is lost. The seconds are of a test with what it sets up
# first, such as the stack or enrolled robots.
ENDS_AFTER = --timeout-method thread --timeout $(1) -o faulthandler_timeout=$(shell expr $(1) - 5)
# Machines with a Docker engine of their own inside, which need all of this one.
SERVERS := tests/ansible/test_server.py tests/ansible/test_site.py
# Tests of images that share no stack: the playbooks, beside which the others run, end sooner than those.
ALONE := $(addsuffix .py,$(addprefix tests/images/test_,acme certificate kept_cells nginx_log prometheus published_images reverse_proxy secrets))
# Where programs that are no tests find the modules of tests/support.
SUPPORT := tests/support/fakes:tests/support/networks:tests/support/stack:tests/support/browser

# Each worker of the tests and each program that they start compiles all it imports anew without Python's caches.
unexport PYTHONDONTWRITEBYTECODE

comma := ,

.PHONY: help demo up down docker images robot-host-image test-hosts compiled-tests test test-release test-unit test-images test-e2e test-running test-ansible test-server lint check check-lint check-unit coverage mutants bench experiments screenshots venv frontend-test docs clean

help: ## print this list
	@grep -hE '^[a-z0-9-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z0-9-]+):[^#]*## /\1\t/' | expand -t 16

demo: ## the stack and five simulated robots, then URL, user and password
	@tools/up --demo-more

up: ## the stack alone
	@tools/up

down: ## stop the stack and the simulated robots; data stays
	@tools/compose --profile '*' down

docker:
	@[ -n "$$IMAGES_ARE_BUILT" ] || { tools/ensure_docker && tools/ensure_base_image; }

images: docker ## build all images
	@[ -n "$$IMAGES_ARE_BUILT" ] || tools/build demo ros2_robot

robot-host-image: docker
	@[ -n "$$IMAGES_ARE_BUILT" ] || tools/ensure_robot_host_image

test-hosts: docker
	@tools/ensure_test_hosts

venv: $(VENV)/.complete ## the Python tools that tests and checks need

$(VENV)/.complete: requirements/dev.txt requirements/uv.txt tools/ensure_venv
	@tools/ensure_venv $(VENV)

# Else each worker compiles each test file for itself, as they all start at once.
compiled-tests: venv
	@said=$$($(PYTEST) --collect-only -q --snapshot-warn-unused tests benchmarks/tests) || { echo "$$said"; exit 1; }

test: ## everything that any change may break: checks, unit, images, end to end, playbooks (some 11 minutes on two cores)
	@[ -n "$$CI" ] || tools/ensure_docker  # its questions, which several jobs at once cannot ask
	@$(MAKE) --no-print-directory --jobs=3 --output-sync=target IN_TURN=yes test-unit test-ansible test-running frontend-test lint

# Unit tests wait for most of their time: beside them images are built, robots installed and sources checked. Drives and
# pages, which end when the machine is late, come when they are over.
ifdef IN_TURN
test-running: test-unit
endif

test-release: venv images robot-host-image test-hosts ## before a release, after make test: long tests, experiments in small, server.yml, site.yml (some 40 minutes)
	@IMAGES_ARE_BUILT=yes $(PYTEST) $(BY_FILE) $(call ENDS_AFTER,900) -m release tests/unit tests/images tests/e2e tests/ansible $(SERVERS:%=--ignore %)
	@IMAGES_ARE_BUILT=yes $(MAKE) --no-print-directory test-server
	@IMAGES_ARE_BUILT=yes $(MAKE) --no-print-directory experiments QUICK=1

lint: venv ## ruff, mypy, shellcheck, hadolint, yamllint, ansible-lint
	@nice tools/lint

test-unit: compiled-tests test-hosts ## unit tests: real sockets, real MariaDB, real OpenSSH; and the fuzzers for a while
	@$(PYTEST) -n 6 --dist worksteal $(call ENDS_AFTER,120) -m "not release" tests/unit benchmarks/tests tests/fuzz

check: venv ## the short loop: ruff, mypy, and the unit tests that neither start processes nor wait
	@$(MAKE) --no-print-directory --jobs=2 --output-sync=target check-lint check-unit

check-lint:
	@tools/lint quick

check-unit:
	@$(PYTEST) -q -n 2 --dist worksteal -p no:schemathesis --hypothesis-profile quick --timeout 60 -m "not daemon and not waits" tests/unit

coverage: venv test-hosts ## branch coverage of the product by its unit tests, into tests/artifacts/coverage (some 20 minutes)
	@$(VENV)/bin/python tools/coverage.py

mutants: venv ## how many faults in the rules that keep robots safe the unit tests notice (up to an hour; ONLY=guard,leases,...)
	@$(VENV)/bin/python tools/mutants.py $(subst $(comma), ,$(ONLY))

docs: venv ## the documents as a site, into build/docs; fails on a dead link
	@NO_MKDOCS_2_WARNING=1 PYTHONPATH=common:server $(VENV)/bin/mkdocs build --quiet --strict

frontend-test: docker ## the browser modules' own tests, in the image's Node.js
	@tools/test_frontend

test-images: venv images ## ask the daemons in the images what is in force
	@IMAGES_ARE_BUILT=yes $(PYTEST) $(BY_FILE) $(call ENDS_AFTER,300) -m "not release" tests/images

test-e2e: venv images test-hosts ## a browser and programs over a running stack of its own
	@IMAGES_ARE_BUILT=yes $(PYTEST) $(BY_FILE) $(call ENDS_AFTER,300) -m "not release" tests/e2e

test-running: venv images test-hosts ## the tests of images and end to end in one go, with fewer stacks to start
	@IMAGES_ARE_BUILT=yes $(PYTEST) $(BY_FILE) $(call ENDS_AFTER,300) -m "not release" tests/images tests/e2e $(ALONE:%=--ignore %)

# Nice: an installation can wait for the drives that are tested beside it, which end when the machine is late.
test-ansible: venv images robot-host-image test-hosts ## playbooks and install line on hosts that boot systemd, against a stack of their own; and images alone
	@IMAGES_ARE_BUILT=yes nice $(PYTEST) $(BY_FILE) -n 1 $(call ENDS_AFTER,600) -m "not release" tests/ansible $(ALONE) $(SERVERS:%=--ignore %)

test-server: venv images robot-host-image test-hosts ## server.yml and site.yml on machines of their own with a Docker engine inside (some 18 minutes)
	@$(PYTEST) $(SERVERS)

bench: venv test-hosts ## latency, recovery, video and loads, into docs/measurements.md (about an hour; BENCH="--only A,B": these alone); needs make demo and root
	@PYTHONPATH=$(SUPPORT):common:agent:server:images/sim_robot $(VENV)/bin/python benchmarks/bench.py $(BENCH)

experiments: venv images test-hosts ## a machine's limits, and cells that break, into docs/experiments (hours; QUICK=1: minutes; FULL=1, ONLY=PART,PART-STEP,...); needs root
	@IMAGES_ARE_BUILT=yes PYTHONPATH=$(SUPPORT):common:agent:server:images/sim_robot:benchmarks \
	  $(VENV)/bin/python -m paper.experiments $(if $(ONLY),--only $(subst $(comma), ,$(ONLY))) \
	  $(if $(QUICK),--quick) $(if $(FULL),--full)

screenshots: venv test-hosts ## the documents' pictures, into docs; needs make demo, with COMPOSE_PROFILES=metrics
	@PYTHONPATH=$(SUPPORT) $(VENV)/bin/python tests/support/browser/screenshots.py

clean: ## remove what tests and tools made here (not the stack's data)
	@rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache tests/artifacts ansible/build
