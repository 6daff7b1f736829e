"""Run a benchmark: `python -m experiments.benchmarks NAME [--json FILE]`."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from qdenv import interrupt

if __name__ == "__main__":
    interrupt.watch("python -m experiments.benchmarks")

import importlib
import sys

from qdenv.commands.parsing import run_program
from qdenv.progress import Bar

BENCHMARKS = (
    *("pipeline", "simulate", "repair", "search", "maze", "scale", "surrogate"),
    *("pages", "executors"),
)


def main() -> int:
    """Run the benchmark named on the command line; each has a `run` with its own options."""
    if len(sys.argv) < 2 or sys.argv[1] not in BENCHMARKS:
        print(
            f"qdenv: usage: python -m experiments.benchmarks {{{','.join(BENCHMARKS)}}}",
            file=sys.stderr,
        )
        return 2
    name = sys.argv[1]
    benchmark = importlib.import_module(f"experiments.benchmarks.{name}").run
    with Bar(f"measuring: {name}"):
        return run_program(benchmark, f"python -m experiments.benchmarks {name}", sys.argv[2:])


if __name__ == "__main__":
    sys.exit(main())
