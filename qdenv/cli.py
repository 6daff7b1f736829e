"""The command line `qdenv`: choose a command, turn mistakes into one line and exit code 2."""

import os

# Before numpy is loaded: small eigenproblems on shared cores lose tenfold to BLAS threads.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import sys
from collections.abc import Callable
from pathlib import Path

import jax
import tyro

from qdenv.commands import layouts, mazes, runs, sizes, traffic
from qdenv.commands.choices import bind
from qdenv.types import InputError

COMMANDS: dict[str, Callable] = {
    "train": runs.Train,
    "resume": runs.resume,
    "plot": runs.plot,
    "presets": runs.presets,
    "generate": runs.generate,
    "series": sizes.series,
    "compare": traffic.compare,
    "scalability": traffic.scalability,
    "layout human": sizes.layout_human,
    "layout tile": sizes.layout_tile,
    "repair": layouts.repair,
    "check": layouts.check,
    "simulate": traffic.simulate,
    "sweep": traffic.sweep,
    "train-agent": mazes.train_agent,
    "convert-agent": mazes.convert_agent,
    "evaluate-agent": mazes.evaluate_agent,
}


def run(arguments: list[str]) -> int:
    """Run one command and return its exit code.

    Args:
        arguments: what follows `qdenv` on the command line.
    """
    try:
        if arguments[:1] == ["train"]:
            runs.train(arguments[1:])
            return 0
        if " ".join(arguments[:2]) in COMMANDS:
            arguments = [" ".join(arguments[:2]), *arguments[2:]]
        chosen = {
            name: bind(command, arguments[1:] if [name] == arguments[:1] else ())
            for name, command in COMMANDS.items()
        }
        code = tyro.extras.subcommand_cli_from_dict(chosen, prog="qdenv", args=arguments)
        return code if isinstance(code, int) else 0
    except InputError as error:
        print(f"qdenv: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("qdenv: stopped; `qdenv resume RUN_DIR` continues a run", file=sys.stderr)
        return 130


def main() -> None:
    """Run the command line; programs are kept between calls where they hold no host callback."""
    cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "qdenv" / "jax"
    jax.config.update("jax_compilation_cache_dir", str(cache))
    sys.exit(run(sys.argv[1:]))
