# The verbs of this repository. `make` alone prints them; each installs what it misses.
SHELL := /bin/bash
.DEFAULT_GOAL := help
VENV := .venv
PYTEST := $(VENV)/bin/pytest
# Two files at once, each beside a stack of its own; those that take long first (tests/conftest.py).
BY_FILE := -n 2 --dist loadfile --no-loadscope-reorder
# Where programs that are no tests find the modules of tests/support.
SUPPORT := tests/support/fakes:tests/support/networks:tests/support/stack:tests/support/browser

comma := ,

.PHONY: help demo up down images test test-unit test-images test-e2e test-running test-ansible test-server lint check coverage mutants bench experiments enrol-times screenshots venv frontend-test clean

help: ## print this list
	@grep -hE '^[a-z0-9-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z0-9-]+):[^#]*## /\1\t/' | expand -t 16

demo: ## the stack and three simulated robots, then URL, user and password
	@tools/up --demo

up: ## the stack alone
	@tools/up

down: ## stop the stack and the simulated robots; data stays
	@tools/compose --profile '*' down

images: ## build all images
	@[ -n "$$IMAGES_ARE_BUILT" ] || { tools/ensure_docker && tools/ensure_base_image && tools/build demo; }

venv: $(VENV)/.complete ## the Python tools that tests and checks need

$(VENV)/.complete: requirements/dev.txt tools/ensure_venv
	@tools/ensure_venv $(VENV)

test: venv ## everything: checks, unit, images, end to end, playbooks, experiments in small (some 35 minutes on two cores)
	@tools/ensure_test_hosts
	@$(MAKE) --no-print-directory --jobs=2 lint images frontend-test
	@IMAGES_ARE_BUILT=yes $(MAKE) --no-print-directory test-unit test-running test-ansible
	@IMAGES_ARE_BUILT=yes $(MAKE) --no-print-directory experiments QUICK=1 RESTART=1

lint: venv ## ruff, mypy, shellcheck, hadolint, yamllint, ansible-lint
	@tools/lint

test-unit: venv ## unit tests: real sockets, real MariaDB, real OpenSSH; and the fuzzers for a while
	@tools/ensure_test_hosts
	@$(PYTEST) -n 4 --timeout 120 --timeout-method thread -m "not alone" tests/unit benchmarks/tests tests/fuzz
	@$(PYTEST) --timeout 120 --timeout-method thread -m alone tests/unit benchmarks/tests

check: venv ## the short loop: ruff, mypy, and the unit tests that neither start processes nor wait
	@tools/lint quick
	@$(PYTEST) -q -n 2 --timeout 60 -m "not daemon and not waits and not alone" tests/unit

coverage: venv ## branch coverage of the product by its unit tests, into tests/artifacts/coverage (some 20 minutes)
	@tools/ensure_test_hosts
	@$(VENV)/bin/python tools/coverage.py

mutants: venv ## how many faults in the rules that keep robots safe the unit tests notice (up to an hour; ONLY=guard,leases,...)
	@$(VENV)/bin/python tools/mutants.py $(subst $(comma), ,$(ONLY))

frontend-test: ## the browser modules' own tests, in the image's Node.js
	@tools/ensure_docker && tools/ensure_base_image && tools/test_frontend

test-images: venv images ## ask the daemons in the images what is in force
	@IMAGES_ARE_BUILT=yes $(PYTEST) $(BY_FILE) tests/images

test-e2e: venv images ## a browser and programs over a running stack of its own
	@tools/ensure_test_hosts
	@IMAGES_ARE_BUILT=yes $(PYTEST) $(BY_FILE) tests/e2e

test-running: venv images ## the tests of images and end to end in one go, with two stacks less to start
	@tools/ensure_test_hosts
	@IMAGES_ARE_BUILT=yes $(PYTEST) $(BY_FILE) tests/images tests/e2e

test-ansible: venv images ## playbooks and install line on hosts that boot systemd, against a stack of their own
	@tools/ensure_test_hosts
	@tools/ensure_robot_host_image
	@IMAGES_ARE_BUILT=yes $(PYTEST) $(BY_FILE) tests/ansible --ignore tests/ansible/test_server.py

test-server: venv images ## server.yml on a machine of its own with a Docker engine inside; not in make test, for its 4 to 9 minutes
	@tools/ensure_test_hosts
	@tools/ensure_robot_host_image
	@$(PYTEST) tests/ansible/test_server.py

enrol-times: venv images ## seconds from ansible-playbook, and from power-on, to a drivable robot; one and five robots
	@tools/ensure_robot_host_image
	@PYTHONPATH=$(SUPPORT):common:server $(VENV)/bin/python benchmarks/enrol_times.py

bench: venv ## latency, recovery, video and loads, into docs/measurements.md (some 45 minutes; BENCH="--only A,B": these alone); needs make demo and root
	@tools/ensure_test_hosts
	@PYTHONPATH=$(SUPPORT):common:agent:server $(VENV)/bin/python benchmarks/bench.py $(BENCH)

experiments: venv images ## the paper's experiments and more, into docs/experiments (hours; QUICK=1: minutes; FULL=1, ONLY=PART,..., RESTART=1, PAGE_ONLY=1); needs root
	@tools/ensure_test_hosts
	@IMAGES_ARE_BUILT=yes PYTHONPATH=$(SUPPORT):benchmarks:common:agent:server:images/sim_robot $(VENV)/bin/python -m paper \
	  $(if $(QUICK),--quick) $(if $(FULL),--full) $(if $(RESTART),--restart) $(if $(PAGE_ONLY),--page-only) $(if $(ONLY),--only $(ONLY))

screenshots: venv ## pictures of all pages and states into docs/screenshots; needs make demo
	@tools/ensure_test_hosts
	@PYTHONPATH=$(SUPPORT) $(VENV)/bin/python tests/support/browser/screenshots.py

clean: ## remove what tests and tools made here (not the stack's data)
	@rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache tests/artifacts ansible/build
