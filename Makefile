# make demo   the main job on a simulated joint       make test   linters, types, pages, tests
# Both make their own environment from a lock. Options: PYTHON=/path/to/python  PYTEST_ARGS='...'
# ARGS='...' (to hd-diag demo, bench/challenge.py, bench/suite.py, bench/soak.py)

ifneq ($(shell test -w . && echo yes),yes)
# The tree is read-only: all is done in a copy.
GOALS := $(or $(MAKECMDGOALS),help)
.PHONY: $(GOALS)
$(firstword $(GOALS)):
	@copy=$$(sh scripts/copy_tree.sh) && echo "== This tree is read-only: make works in $$copy" && \
	    $(MAKE) --no-print-directory -C "$$copy" $(GOALS)
$(wordlist 2,99,$(GOALS)): ;
else

PYTHON ?=
ARGS ?=
PYTEST_ARGS ?=
SELECTED = -m 'not slow'
# Test processes at once, one more than two cores: live tests wait, numerical ones do not. A file's tests stay in one.
SPREAD = --no-loadscope-reorder -n $(1)
SHELL = /bin/sh

# The environments bring their own ROS; nothing of a sourced one may mix in.
unexport PYTHONPATH PYTHONHOME LD_LIBRARY_PATH _ROS_WHEELS_BOOTSTRAP_COMPLETE COLCON_PREFIX_PATH CMAKE_PREFIX_PATH
# pytest keeps its compiled tests, which costs ten seconds a process otherwise.
unexport PYTHONDONTWRITEBYTECODE
export RMW_IMPLEMENTATION = rmw_fastrtps_cpp
ENVIRONMENT = sh scripts/environment.sh
IN = AMENT_PREFIX_PATH='$(CURDIR)/.venv/$(1)' PATH="$(CURDIR)/.venv/$(1)/bin:$$PATH"

.PHONY: help demo test test-all environments lint docs types types-and-ubuntu pytest pytest-ubuntu challenge bench soak audit install lock clean
.NOTPARALLEL:

help:
	@echo "make demo     run the main job on a simulated joint (one to two minutes; the first time also installs and compiles, 3 minutes of computing)"
	@echo "make test     linters, types, documentation and tests, on the newest numpy and on Ubuntu 24.04's (6 minutes)"
	@echo "make test-all the same with all that takes long: whole challenges, fuzzing, fleets, colcon (half an hour)"
	@echo "make docs     the documentation alone: docs/_build/html/index.html"
	@echo "make challenge  hidden causes to be found, beside plain methods (about 25 s a record; see ARGS=--help)"
	@echo "make bench    speed beside the paper's method and plain libraries (some minutes; see ARGS=--help)"
	@echo "make soak     the node for an hour while all around it changes (ARGS='--seconds 180' for less)"
	@echo "make audit    known vulnerabilities of all that the locks install (needs the network)"
	@echo "make install  bring the test environment .venv/test up to date with this tree"
	@echo "make lock     resolve requirements/*.txt anew"
	@echo "make clean    remove environments and build results"

demo:
	@$(ENVIRONMENT) demo '$(PYTHON)'
	@echo "== hd-diag demo (one to two minutes)"
	@$(call IN,demo) hd-diag demo $(ARGS)

# The tests build the pages too (test/test_docs.py).
test test-all: environments lint types-and-ubuntu pytest
test-all: SELECTED =

# mypy works on one core, the first time for a minute: the numerical tests have the other, and it tells after them.
types-and-ubuntu: install
	@$(MAKE) --no-print-directory types >.venv/types.log 2>&1 & types=$$!; \
	$(MAKE) --no-print-directory pytest-ubuntu SELECTED="$(SELECTED)"; ended=$$?; \
	wait $$types || ended=1; cat .venv/types.log; exit $$ended

# Both at once: pip works on one core, and what fails of the second is told where it is used.
environments:
	@python=$$(sh scripts/find_python.sh '$(PYTHON)' .venv/test) && \
	if "$$python" -c 'import sys; sys.exit(sys.version_info >= (3, 13))'; then \
	    mkdir -p .venv && { $(ENVIRONMENT) ubuntu "$$python" 2>/dev/null & } && $(ENVIRONMENT) test "$$python"; \
	    ended=$$?; wait; exit $$ended; \
	fi

install:
	@$(ENVIRONMENT) test '$(PYTHON)'

lint: install
	@echo "== Linters: ruff format --check, ruff check (1 s)"
	@$(call IN,test) ruff format --check .
	@$(call IN,test) ruff check .

docs: install
	@if .venv/test/bin/python -c 'import sys; sys.exit(sys.version_info >= (3, 11))'; then \
	    echo "== SKIPPED documentation: its tools need Python 3.11 to 3.13"; \
	else \
	    echo "== Documentation into docs/_build/html, warnings as errors (half a minute)" && \
	    $(call IN,test) sphinx-build -q -W --keep-going -b html docs docs/_build/html; \
	fi

types: install
	@if .venv/test/bin/python -c 'import sys; sys.exit(sys.version_info >= (3, 11))'; then \
	    echo "== SKIPPED types: the last numpy for Python 3.10 describes its types too loosely;" \
	         "run make test with a Python 3.11 to 3.13"; \
	else \
	    echo "== Types: mypy (up to 1 minute the first time)" && $(call IN,test) mypy; \
	fi

# Test processes share the cores already: more threads of BLAS in each wait for one another, a quarter of the time.
pytest pytest-ubuntu: export OPENBLAS_NUM_THREADS = 1

pytest: install
	@echo "== Tests, newest numpy (5 minutes)"
	@$(call IN,test) pytest $(call SPREAD,3) --durations=10 $(SELECTED) $(PYTEST_ARGS)

# Arithmetic of model, drive, effects, monitor (with its streams) and diagnosis; what else there is does not depend on numpy.
NUMERICAL = contact design drive effects evidence extended_model fit_parameters joint_refinement \
       linearised_fit load_sharing monitor noise refit remainders smoothing torsion torsion_map
pytest-ubuntu:
	@python=$$(sh scripts/find_python.sh '$(PYTHON)' .venv/test) && \
	if "$$python" -c 'import sys; sys.exit(sys.version_info < (3, 13))'; then \
	    echo "== SKIPPED tests with numpy 1.26 and scipy 1.11: they have no wheels for $$("$$python" -V);" \
	         "run make test with a Python 3.10 to 3.12"; \
	else \
	    $(ENVIRONMENT) ubuntu "$$python" && \
	    echo "== Numerical tests, numpy 1.26 and scipy 1.11 as in Ubuntu 24.04 (1 minute)" && \
	    $(call IN,ubuntu) pytest $(call SPREAD,2) $(SELECTED) $(PYTEST_ARGS) $(NUMERICAL:%=test/test_%.py); \
	fi

challenge:
	@$(ENVIRONMENT) challenge '$(PYTHON)'
	@$(call IN,challenge) python bench/challenge.py $(ARGS)

# One run on a quiet machine: ratios of what is timed side by side. ARGS='--json bench/results.json' keeps them.
bench: install
	@$(call IN,test) python bench/suite.py $(ARGS)

# Losses and memory, beside docs/tables/faults.md. On a quiet machine.
soak: install
	@$(call IN,test) python bench/soak.py --markdown docs/tables/soak.md $(ARGS)

audit:
	@sh scripts/audit.sh '$(PYTHON)'

lock:
	@sh scripts/lock.sh '$(PYTHON)'

clean:
	rm -rf .venv build install log docs/_build *.egg-info .mypy_cache .pytest_cache .ruff_cache .hypothesis

endif
