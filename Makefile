# A machine with Python >= 3.11 and make needs no more. `make help` lists the targets.
# PYTHON=... chooses the interpreter; by default that of .venv, else the first on PATH that is new enough.
SHELL := bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help
# Every worker of the tests, and the hundreds of processes that they start, would compile all modules anew.
unexport PYTHONDONTWRITEBYTECODE

venv := .venv
python := $(venv)/bin/python
PYTHON ?= $(wildcard $(python))
# Brings .venv to a lock of requirements/; at once if it is there already, or has more (run after test).
setup = INPUT_PYTHON='$(PYTHON)' bash actions/bootstrap.sh environment $(venv)

uv = $(abspath $(or $(shell command -v uv),$(venv)/bin/uv))
# Many tests wait, for an engine or a browser: three for each processor are run at once, eight at most.
tests = $(python) -m pytest -n $(shell n=$$(getconf _NPROCESSORS_ONLN); echo $$(( n > 2 ? 8 : 3 * n ))) --dist worksteal
rooms = $(patsubst tests/%/__init__.py,%,$(wildcard tests/*/__init__.py tests/*/*/__init__.py tests/*/*/*/__init__.py))
# Of the engine, the detectors and the renderer; and those of them that use OpenCV.
engine_tests = $(addprefix tests/engine/,geometry dataset estimation evaluation comparison) tests/robot/labelling tests/robot/simulation/rendering
opencv_tests = $(addprefix tests/,engine/dataset/test_depth_image.py engine/dataset/test_reading.py engine/comparison robot/labelling robot/simulation/rendering)

.PHONY: help run check lint test test-coverage fuzz faults bench bench-table lock test-versions actions pictures docs dist image owner aws-example clean

help: ## this list
	@sed -nE 's/^([a-z-]+):.*## (.*)/\1\t\2/p' Makefile | expand -t 16

run: ## calibrate the systems in datasets/ and check the tables, as calibration.yml says
	@$(setup) engine.txt
	@$(python) -m calibration run $(ARGS)

check: ## ROOM=engine/geometry: ruff, mypy, and the tests of one room with few examples: while one works on it
	@[[ ' $(rooms) ' == *' $(ROOM) '* ]] || { echo "ROOM=$(ROOM): no such room; there are: $(rooms)" >&2; exit 2; }
	@$(setup) dev.txt .
	$(python) -m ruff check --quiet
	$(python) -m ruff format --check --quiet
	$(python) -m mypy
	$(python) -m pytest -q -n 2 --dist worksteal --hypothesis-profile few tests/$(ROOM) $(ARGS)

lint: ## ruff, mypy, and the checks of workflows, actions, shell, configurations and the README's examples
	@$(setup) dev.txt .
	$(python) -m ruff check
	$(python) -m ruff format --check
	$(python) -m mypy
	$(python) -m mypy --strict actions/bootstrap.py
	$(venv)/bin/zizmor --offline --quiet .github action.yml actions
	$(python) -m tests.lint.shell
	$(python) -m tests.lint.documents

# Both halves at once; else every worker would compile all tests for itself. A failure here only costs time:
# tests that cannot be collected fail in the run that follows.
compiled = tests/__pycache__/all-compiled
$(compiled):
	@$(setup) dev.txt .
	@echo 'compiling the tests'
	@echo tests/*/ | xargs -n $$(( ($(words $(wildcard tests/*/)) + 1) / 2 )) -P 2 $(python) -m pytest --collect-only -qq >/dev/null || true
	@mkdir -p $(@D)
	@touch $@

test: | $(compiled) ## the tests
	@$(setup) dev.txt .
	$(tests) $(ARGS)

test-coverage: | $(compiled) ## the tests with their coverage of calibration/, which takes a quarter more
	@$(setup) dev.txt .
	$(python) -m coverage erase
	COVERAGE_PROCESS_START='$(CURDIR)/pyproject.toml' COVERAGE_FILE='$(CURDIR)/.coverage' $(tests) $(ARGS)
	$(python) -m coverage combine --quiet
	$(python) -m coverage report

# An older or newer library, laid over those of .venv. Not strict: OpenCV 5 lacks what some comparisons need.
test-versions: ## the tests of engine, detectors and rendering with the oldest numpy, and those that use it with OpenCV 5
	@$(setup) dev.txt .
	@with() { \
		echo "$$1"; \
		rm -rf build/versions; \
		'$(uv)' pip install --quiet --no-deps --only-binary :all: --python $(python) --target build/versions "$$1"; \
		CALIBRATION_CI_STRICT= PYTHONPATH='$(CURDIR)/build/versions' \
			$(python) -m pytest -n 2 -q -p no:cacheprovider --hypothesis-profile few \
			-m 'not many_scenes and not thorough' "$${@:2}"; \
	}; \
	with 'numpy==1.26.*' $(engine_tests); \
	with 'opencv-python-headless>=5' $(opencv_tests)

fuzz: ## readers against files that were changed by a seed: ARGS='--cases 100000 --seed 1'
	@$(setup) dev.txt .
	$(python) -m tests.campaigns.fuzz $(ARGS)

faults: ## commands on machines that fail, by a seed: signals, a full disk, little memory: ARGS='--cases 500 --seed 1'
	@$(setup) dev.txt .
	$(python) -m tests.campaigns.faults $(ARGS)

bench: ## what the measurements of benchmarks/ print
	@$(setup) dev.txt .
	$(python) -m benchmarks $(ARGS)

bench-table: ## the speed table of the README, beside ceres, gtsam, mrcal, pyceres and scipy as far as they are installed
	@$(setup) dev.txt .
	OPENBLAS_NUM_THREADS=1 $(python) -m benchmarks --only peers --json .peers.json || true
	$(python) -m benchmarks.speed_table .peers.json README.md
	rm .peers.json

# dev.txt is resolved first and binds the others, so that what is tested is what the actions install, and that an
# environment for the tests serves `make run` too. `make lock UPGRADE=--upgrade` takes the newest versions.
compile := pip compile pyproject.toml --quiet --no-config --universal --python-version 3.11 --only-binary :all: \
	--generate-hashes --no-emit-index-url --no-emit-find-links --annotation-style line --custom-compile-command 'make lock'
lock: ## resolve requirements/*.txt again after a change in pyproject.toml
	@test -x '$(uv)' || { echo "make lock needs uv: pip install uv"; exit 2; }
	'$(uv)' $(compile) $(UPGRADE) --all-extras --group dev --output-file requirements/dev.txt
	'$(uv)' $(compile) --extra calibrate --extra opencv --constraint requirements/dev.txt --output-file requirements/engine.txt
	'$(uv)' $(compile) --extra calibrate --extra opencv --extra containers --extra aws --constraint requirements/dev.txt --output-file requirements/calibrate.txt
	'$(uv)' $(compile) --extra containers --extra aws --constraint requirements/dev.txt --output-file requirements/image.txt
	'$(uv)' $(compile) --extra calibrate --extra opencv --extra bags --extra xacro --extra figures --extra containers --extra aws --extra analysis --extra requirements --extra delivery --constraint requirements/dev.txt --output-file requirements/run.txt
	'$(uv)' $(compile) --extra coverage --constraint requirements/dev.txt --output-file requirements/coverage.txt
	'$(uv)' $(compile) --extra github --constraint requirements/dev.txt --output-file requirements/github.txt
	'$(uv)' $(compile) --extra analysis --constraint requirements/dev.txt --output-file requirements/analysis.txt
	'$(uv)' $(compile) --constraint requirements/dev.txt --output-file requirements/introspect.txt
	'$(uv)' $(subst pip compile pyproject.toml,pip compile --group installer,$(compile)) --constraint requirements/dev.txt --output-file requirements/uv.txt

actions: ## write the inputs of the commands into every action.yml, and the records into the JSON Schemas
	@$(setup) dev.txt .
	$(python) -m tests.actions.write_inputs

pictures: ## draw the pictures of the README, docs/recording.svg and the maps of docs/convergence.md
	@$(setup) dev.txt .
	$(python) -m benchmarks.run_picture
	$(python) -m benchmarks.report_picture
	$(python) -m benchmarks.task_picture
	$(python) -m benchmarks.recording.pictures
	$(python) -m benchmarks.next_pose_picture
	$(python) -m calibration convergence --dataset datasets/t2rgb --translation-noise 0:2:9 --rotation-noise 0:3:13 --output build/convergence
	cp build/convergence/convergence.svg docs/convergence-t2rgb.svg

docs: ## the documentation as a site, in build/site (ARGS=serve shows it while one writes)
	@$(setup) dev.txt .
	@NO_MKDOCS_2_WARNING=1 $(python) -m mkdocs $(or $(ARGS),build --quiet)

dist: ## the wheel and the source archive in dist/, by the build backend of the lock
	@$(setup) uv.txt
	rm -rf dist
	'$(uv)' build --quiet --build-constraint requirements/dev.txt --require-hashes --no-create-gitignore --out-dir dist .

# What the actions install is what is in it, by their lock.
image: ## a container image of the wheel in dist/, with all commands: IMAGE=..., ARGS='--build-arg BASE=...'
	@[ -n '$(IMAGE)' ] && ls dist/*.whl >/dev/null || { echo 'make dist, then: make image IMAGE=NAME:TAG' >&2; exit 2; }
	rm -rf build/image
	mkdir -p build/image
	cp dist/*.whl examples/aws-batch/Dockerfile build/image
	sed -nE 's/^([a-z0-9].*[^ ]) +\\$$/\1/p' requirements/run.txt >build/image/constraints.txt
	docker build --tag '$(IMAGE)' --build-arg EXTRAS='$(image_extras)' \
	  --build-arg SOURCE=file:///context/$$(cd dist; ls *.whl) $(ARGS) build/image
image_extras := calibrate,opencv,bags,xacro,figures,containers,aws,analysis,requirements,delivery

owner: ## OWNER=team: whose this repository is on GitHub, in every file that says it
	@[[ '$(OWNER)' =~ ^[A-Za-z0-9-]+$$ ]] || { echo 'make owner OWNER=NAME: the name of a user or an organisation' >&2; exit 2; }
	@now=$$(sed -nE 's|^DEFAULT_SUITE = "(.*)/calibration-ci@v1"$$|\1|p' calibration/commands/init.py); \
	git grep -lIE "\<$$now/calibration-ci\>|@$$now\>" | xargs perl -pi -e "s{\b$$now(?=/calibration-ci\b)|(?<=@)$$now\b}{$(OWNER)}g"

aws-example: ## scenarios on an emulated AWS Batch, in real containers, without an account (IMAGE=one with calibration-ci in it)
	@$(setup) dev.txt .
	@if [ -z '$(IMAGE)' ]; then \
	  rm -f examples/aws-batch/*.whl; trap 'rm -f examples/aws-batch/*.whl' EXIT; \
	  '$(uv)' build --wheel --quiet --out-dir examples/aws-batch .; \
	  docker build --quiet --tag calibration-tools:example --build-arg EXTRAS=aws,calibrate,opencv \
	    --build-arg SOURCE=file:///context/$$(cd examples/aws-batch; ls *.whl) examples/aws-batch; \
	fi
	$(python) -m tests.aws.example --image '$(or $(IMAGE),calibration-tools:example)'

clean: ## remove what running and testing leave behind (not .venv)
	rm -rf output build dist .coverage .coverage.* coverage.xml .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -not -path './$(venv)/*' -prune -exec rm -rf {} +
