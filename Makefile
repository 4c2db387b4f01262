# make demo: drapes a bundled groom on a bundled motion, into out/.   make test: all checks but slow tests; WORKERS=2 in two processes.
# make test-slow: the slow tests.
# make docs: the documentation site, into out/docs.
# make fuzz: damaged files against every reader; MUTANTS of each format, SEED.
# All make .venv first: some minutes and 2 to 6 GB the first time, nothing after that.

PYTHON ?= python3
SHELL := bash
BIN := .venv/bin
MUTANTS ?= 1000
SEED ?= 0
WORKERS ?= 0
SETUP := .venv/setup-done

.PHONY: demo test test-slow docs fuzz setup clean
.DEFAULT_GOAL := demo

demo: $(SETUP)
	@mkdir -p out
	@echo "Draping the bundled groom long_wavy on the bundled motion walk, then drawing it: some minutes."
	$(BIN)/quaffure drape long_wavy --motion walk --frames ::2 $(addprefix --out out/demo.,npz usd mp4)
	$(BIN)/quaffure render out/demo.npz --strands 12000 --out out/demo.png
	@echo "Next: source $(BIN)/activate, for the command quaffure; README.md has more."

# pytest stays last: its summary is the last line of the output.
test: $(SETUP)
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/pytest --numprocesses $(WORKERS) --dist loadfile

test-slow: $(SETUP)
	$(BIN)/pytest --numprocesses $(WORKERS) --dist loadfile -m "slow and not long"

docs: $(SETUP)
	$(BIN)/sphinx-build -q -W -b html docs out/docs
	@echo "written: out/docs/index.html"

fuzz: $(SETUP)
	$(BIN)/python -m tests.fuzzing.fuzz --mutants $(MUTANTS) --seed $(SEED) --keep out/faults

setup: $(SETUP)

$(SETUP): pyproject.toml constraints.txt scripts/set_up.sh
	@PYTHON="$(PYTHON)" bash scripts/set_up.sh
	@touch $@

clean:
	rm -rf .venv out
