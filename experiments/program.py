"""Programs that are one function: its arguments are the options, its docstring is the help."""

import os
import sys
from collections.abc import Callable, Sequence
from typing import NoReturn

from qdenv import interrupt
from qdenv.cli.parser import bind, parse
from qdenv.types import InputError


def run_program(function: Callable, program: str, words: Sequence[str] | None = None) -> NoReturn:
    """Run a program that is one function, whose arguments are its options, and exit.

    `program` is how it is called, like "python -m experiments.benchmarks maze"; `words` are those
    of this process unless given.
    """
    interrupt.watch(program)
    try:
        bound = parse(bind(function), sys.argv[1:] if words is None else words, program)
        function(*bound.args, **bound.kwargs)
        sys.stdout.flush()
    except InputError as error:
        print(f"qdenv: {error}", file=sys.stderr)
        sys.exit(2)
    except BrokenPipeError:  # the reader has read enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    sys.exit()
