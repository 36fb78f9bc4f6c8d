# make render   draws data/head.toml: out/demo.exr, out/demo.png
# make test     runs every property once, on the first device: minutes   (options for pytest: make test ARGS="-k volume")
# make test-all runs every test           (what `make test` leaves out: make test-all ARGS="-m slow")
# make bench    measures, beside a peer   (options: make bench ARGS="...")
# make clean    removes what was made, but for .venv; make distclean removes that as well
#
# Each sets up what it needs (.ci/setup): python3, .venv, an OpenCL CPU device.

.PHONY: render test test-all bench clean distclean
.DEFAULT_GOAL := render
PYTHON := .venv/bin/python
# Processes that share the tests: compilers work on one core.
WORKERS := 2

render:
	@.ci/setup
	@mkdir -p out
	@$(PYTHON) -m clvol render data/head.toml -o out/demo.exr -o out/demo.png
	@printf '%s\n' "$$PWD/out/demo.exr" "$$PWD/out/demo.png"

test:
	@.ci/setup test cpu
	@$(PYTHON) -m pytest -n $(WORKERS) --dist loadfile -m "not slow" $(ARGS)

test-all:
	@.ci/setup test cpu
	@$(PYTHON) -m pytest -n $(WORKERS) --dist loadfile $(ARGS)

bench:
	@.ci/setup bench
	@$(PYTHON) -m bench $(ARGS)

clean:
	rm -rf out build dist *.egg-info .pytest_cache .hypothesis .ruff_cache .mypy_cache bench/results
	find clvol tests bench -name __pycache__ -type d -prune -exec rm -rf {} +

distclean: clean
	rm -rf .venv
