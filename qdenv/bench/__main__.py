"""Run a benchmark: `python -m qdenv.bench NAME [--json FILE]`."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import importlib
import sys

import tyro

from qdenv.types import InputError

BENCHMARKS = ("pipeline", "simulate", "repair", "search", "maze", "scale")


def main() -> None:
    """Run the benchmark named on the command line; each has a `run` with its own options."""
    if len(sys.argv) < 2 or sys.argv[1] not in BENCHMARKS:
        sys.exit(f"usage: python -m qdenv.bench {{{','.join(BENCHMARKS)}}} [--help]")
    name = sys.argv[1]
    benchmark = importlib.import_module(f"qdenv.bench.{name}").run
    try:
        tyro.cli(benchmark, prog=f"python -m qdenv.bench {name}", args=sys.argv[2:])
    except InputError as error:
        sys.exit(f"qdenv: {error}")


if __name__ == "__main__":
    main()
