# Everything stays inside this directory. make help says what there is.
RUN := tools/run
PYTHON3 := $(or $(FBN_PYTHON),python3)

help:  ## this list
	@sed -n 's/^\([a-z]*\):.*## /  make \1\t/p' Makefile | expand -t 18

setup:  ## libraries, ROS and the built packages; nothing to do the second time
	@command -v $(PYTHON3) >/dev/null || { echo "setup: needs Python 3.11 or 3.12 (python3)"; exit 1; }
	@$(PYTHON3) -I tools/prepare.py

demo: setup  ## simulate a search, localise in it, and show the report
	@./fbn demo

test: setup  ## every test but the campaigns
	@$(RUN) python -m pytest

campaign: setup  ## the long statistical tests
	@$(RUN) python -m pytest -m campaign

bench: setup  ## accuracy and speed, against a peer
	@$(RUN) python benchmarks/run.py

lint: setup  ## style, formatting and types
	@$(RUN) ruff check
	@$(RUN) ruff format --check
	@$(RUN) mypy

lock:  ## resolve requirements*.in anew into the two locks
	@.venv/bin/uv pip compile $(LOCK) requirements.in -o requirements.txt
	@.venv/bin/uv pip compile $(LOCK) requirements-app.in -c requirements.txt -o requirements-app.txt
LOCK := --quiet --universal --python-version 3.11 --fork-strategy fewest --generate-hashes \
	--no-emit-index-url --no-emit-find-links --custom-compile-command "make lock"

clean:  ## remove everything that setup made
	rm -rf .venv ros2_ws/build ros2_ws/install ros2_ws/log .mypy_cache .pytest_cache .ruff_cache

.PHONY: help setup demo test campaign bench lint lock clean
