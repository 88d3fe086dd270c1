# `make demo` runs the main job, `make test` the tests; both set up first, once, in .venv.
# With another interpreter: make demo PYTHON=python3.12. With the CUDA build of torch: make demo TORCH=gpu.
# Tests run side by side in two processes; on a larger machine: make test TEST_WORKERS=8.

PYTHON ?= python3
TORCH ?= cpu
TORCH_VERSION := 2.13.0
BIN := .venv/bin
STAGE := configs/stage/default.yaml
TEST_WORKERS ?= 2
DOCS_BUILDER ?= html

LOCK := constraints.txt

PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet

# pip would compile on one core, and what only the packages' own tests need as well: half the time of a set-up.
# What is there is compiled while pip installs the rest. Packages hold files that are not meant to compile.
COMPILE = $(BIN)/python -m compileall -qq -x '/tests?/' .venv/lib
INSTALL = { $(COMPILE) & $(PIP) install --no-compile --constraint $(LOCK) --editable '$(1)' && wait; } \
	&& { $(COMPILE) -j 0 || true; }

# The CPU build: from where pip looks if it is there, else from where uv knows it to be, else the default build.
INSTALL_TORCH_cpu = $(PIP) install --no-compile torch==$(TORCH_VERSION)+cpu 2>/dev/null \
	|| { $(PIP) install uv && $(BIN)/uv pip install --quiet --python $(BIN)/python --torch-backend cpu \
		torch==$(TORCH_VERSION); } 2>/dev/null \
	|| $(PIP) install --no-compile torch==$(TORCH_VERSION)
INSTALL_TORCH_gpu = $(PIP) install --no-compile torch==$(TORCH_VERSION)

.PHONY: demo test figures lint docs links lock clean help

help:
	@echo "make demo     train a compensator on the simulated stage, export it, run it in a control loop"
	@echo "make test     the tests"
	@echo "make figures  measure again what README and docs quote, and renew the numbers"
	@echo "make lint     style and types"
	@echo "make docs     the documentation site, into docs/_build/html; a warning is an error"
	@echo "make links    addresses of others on its pages, which needs the network; one that is broken is an error"
	@echo "make lock     newest versions of all that is installed besides torch, into $(LOCK)"
	@echo "make clean    remove .venv and what the demo left"

demo: .venv/ready
	@rm -rf runs/demo exports/demo exports/demo.pt exports/demo.json
	@echo "==> 1 of 3: training on recordings of the simulated stage ($(STAGE)), into runs/demo"
	@$(BIN)/python -m train fit --config configs/demo.yaml --output runs/demo
	@echo "==> 2 of 3: exporting, to exports/demo.pt and exports/demo.json"
	@$(BIN)/torchpi export runs/demo --output exports/demo
	@echo "==> 3 of 3: control loop against the simulated stage, on the paper's slow and fast trajectories"
	@$(BIN)/torchpi run exports/demo.pt --stage $(STAGE) --trajectory '[slow, fast]' \
		--compare '{two-stage: runs/demo/baseline.pt}'
	@echo "==> Open exports/demo/loop.html (tracking) and runs/demo/report.html (training)."
	@echo "    To watch a training: $(BIN)/tensorboard --logdir runs"

test: .venv/ready-dev
	$(BIN)/python -m pytest -n $(TEST_WORKERS) --dist worksteal

figures: .venv/ready-dev
	$(BIN)/python -m benchmarks.figures

lint: .venv/ready-dev
	$(BIN)/ruff check . && $(BIN)/ruff format --check . && $(BIN)/mypy

docs: .venv/ready-docs
	@rm -rf docs/generated
	$(BIN)/sphinx-build -W --keep-going -q -b $(DOCS_BUILDER) -c docs . docs/_build/$(DOCS_BUILDER)
	@echo "==> Built docs/_build/$(DOCS_BUILDER)"

links: .venv/ready-docs
	$(BIN)/sphinx-build -b linkcheck -q -c docs . docs/_build/links

# torch, and what only its CUDA build needs, are left to TORCH_VERSION.
lock: .venv/ready
	@$(PIP) install uv
	@echo "torch==$(TORCH_VERSION)" > .venv/torch.txt
	@{ echo "# Made by \`make lock\`: the versions that make installs, and CI tests."; \
		$(BIN)/uv pip compile --quiet --universal --upgrade --no-header --no-annotate --constraints .venv/torch.txt \
			--extra dev --extra docs pyproject.toml | grep -Ev '^(torch|triton|cuda-[^ ]*|nvidia-[^ ]*)=='; } > .venv/$(LOCK)
	@mv .venv/$(LOCK) $(LOCK)

clean:
	rm -rf .venv docs/_build docs/generated runs/demo exports/demo exports/demo.pt exports/demo.json

.venv/torch:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "make: $(PYTHON) is too old, want Python 3.11 or newer: make PYTHON=python3.12"; exit 1; }
	@echo "==> Setting up .venv (once; torch alone is some 200 MB)"
	@test -x $(BIN)/python || $(PYTHON) -m venv .venv
	@$(INSTALL_TORCH_$(TORCH))
	@touch $@

.venv/ready: .venv/torch pyproject.toml $(LOCK)
	@$(call INSTALL,.)
	@touch $@

.venv/ready-dev: .venv/torch pyproject.toml $(LOCK)
	@echo "==> Installing it with what the tests need"
	@$(call INSTALL,.[dev])
	@touch $@ .venv/ready

.venv/ready-docs: .venv/torch pyproject.toml $(LOCK)
	@echo "==> Installing it with what the documentation needs"
	@$(call INSTALL,.[docs])
	@touch $@ .venv/ready
