"""Run a benchmark: `python -m experiments.benchmarks NAME [OPTIONS] [--json FILE]`."""

import importlib
import sys
from typing import NoReturn

from experiments.program import run_program

PROGRAM = "python -m experiments.benchmarks"
# Name of a benchmark, which is a function of that name -> its module.
BENCHMARKS = {
    "pipeline": "training",
    "simulate": "simulation",
    "repair": "repair",
    "search": "search",
    "maze": "simulation",
    "scale": "simulation",
    "surrogate": "search",
    "pages": "pages",
    "executors": "training",
}


def main() -> NoReturn:
    """Run the benchmark named on the command line, and exit."""
    name = sys.argv[1] if len(sys.argv) > 1 else ""
    if name not in BENCHMARKS:
        print(f"qdenv: usage: {PROGRAM} {{{','.join(BENCHMARKS)}}}", file=sys.stderr)
        sys.exit(2)
    module = importlib.import_module(f"experiments.benchmarks.{BENCHMARKS[name]}")
    run_program(getattr(module, name), f"{PROGRAM} {name}", sys.argv[2:])


if __name__ == "__main__":
    main()
