"""The command line `qdenv`: choose a command, turn mistakes into one line and exit code 2.

A command is imported when it is chosen: help is read in less time than jax takes to load.
"""

import ast
import importlib
import os
import sys
from collections.abc import Callable
from importlib import metadata, util
from pathlib import Path
from typing import Any

# Before numpy is loaded: small eigenproblems on shared cores lose tenfold to BLAS threads.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import tyro

# Name -> ``module:function``.
COMMANDS = {
    "train": "qdenv.commands.runs:Train",
    "resume": "qdenv.commands.runs:resume",
    "plot": "qdenv.commands.runs:plot",
    "presets": "qdenv.commands.presets:presets",
    "generate": "qdenv.commands.runs:generate",
    "export": "qdenv.commands.export:export",
    "series": "qdenv.commands.sizes:series",
    "compare": "qdenv.commands.traffic:compare",
    "scalability": "qdenv.commands.traffic:scalability",
    "layout human": "qdenv.commands.sizes:layout_human",
    "layout tile": "qdenv.commands.sizes:layout_tile",
    "repair": "qdenv.commands.layouts:repair",
    "check": "qdenv.commands.layouts:check",
    "simulate": "qdenv.commands.simulate:simulate",
    "sweep": "qdenv.commands.traffic:sweep",
    "train-agent": "qdenv.commands.mazes:train_agent",
    "convert-agent": "qdenv.commands.mazes:convert_agent",
    "evaluate-agent": "qdenv.commands.mazes:evaluate_agent",
}


def run(arguments: list[str]) -> int:
    """Run one command and return its exit code.

    Args:
        arguments: what follows `qdenv` on the command line.
    """
    if arguments[:1] == ["--version"]:
        print(metadata.version("qdenv"))
        return 0
    if " ".join(arguments[:2]) in COMMANDS:
        arguments = [" ".join(arguments[:2]), *arguments[2:]]
    # What prints completion for a shell asks for the options of every command.
    completion = any(argument.startswith("--tyro-") for argument in arguments)
    wanted = COMMANDS if completion else arguments[:1]
    try:
        if any(name in COMMANDS for name in wanted):
            return _run_loaded(arguments, [name for name in COMMANDS if name in wanted])
        return _choose({name: summary_of(name) for name in COMMANDS}, arguments)
    except KeyboardInterrupt:
        print("qdenv: stopped; `qdenv resume RUN_DIR` continues a run", file=sys.stderr)
        return 130


def _run_loaded(arguments: list[str], wanted: list[str]) -> int:
    """Import the wanted commands and run the one that is named."""
    from qdenv.commands.choices import bind
    from qdenv.types import InputError

    try:
        if arguments[:1] == ["train"]:
            _attribute("qdenv.commands.runs:train")(arguments[1:])
            return 0
        commands = {name: summary_of(name) for name in COMMANDS}
        for name in wanted:
            given = arguments[1:] if [name] == arguments[:1] else ()
            commands[name] = bind(_attribute(COMMANDS[name]), given)
        return _choose(commands, arguments)
    except InputError as error:
        print(f"qdenv: {error}", file=sys.stderr)
        return 2


def _choose(commands: dict[str, Callable], arguments: list[str]) -> int:
    code = tyro.extras.subcommand_cli_from_dict(commands, prog="qdenv", args=arguments)
    return code if isinstance(code, int) else 0


def _attribute(reference: str) -> Any:
    module, _, name = reference.partition(":")
    return getattr(importlib.import_module(module), name)


def summary_of(command: str) -> Callable[[], None]:
    """Make a function that stands in for a command in help: the same docstring, no options.

    The docstring is read from the source: importing a command would take its seconds.
    """
    module, _, name = COMMANDS[command].partition(":")
    spec = util.find_spec(module)
    assert spec is not None and spec.origin is not None
    (node,) = (
        node
        for node in ast.parse(Path(spec.origin).read_text()).body
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and node.name == name
    )

    def summary() -> None:
        return None

    summary.__doc__ = (ast.get_docstring(node) or "").partition("\n")[0]
    return summary


def main() -> None:
    """Run the command line; programs are kept between calls where they hold no host callback."""
    cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "qdenv" / "jax"
    # Read when jax is imported, which is later. By itself jax keeps what took a second.
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(cache))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.1")
    sys.exit(run(sys.argv[1:]))
