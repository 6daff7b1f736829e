"""From a command line to a call whose arguments are checked; a mistake becomes one line."""

import contextlib
import functools
import inspect
import io
import os
import sys
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import tyro

from qdenv import interrupt
from qdenv.commands.mistakes import one_line

Parsed = TypeVar("Parsed")


def parsed(parse: Callable[[], Parsed], program: str) -> Parsed:
    """Parse a command line.

    Args:
        parse: the parser; prints a frame and exits where the arguments make no sense.
        program: how the command is called, like "qdenv simulate".

    Raises:
        InputError: the arguments make no sense.
        SystemExit: help or completion was asked for, and printed.
    """
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            return parse()
    except SystemExit as stop:
        if stop.code in (0, None):
            raise
        from qdenv.types import InputError  # imports numpy: not for help

        raise InputError(one_line(said.getvalue(), program)) from None


def later(command: Callable) -> Callable:
    """Make a function with the same arguments that checks their ranges and binds them."""

    @functools.wraps(command)
    def bound(*values: Any, **named: Any) -> Callable[[], Any]:
        from qdenv.ranges import check_arguments  # imports numpy: not for help

        check_arguments(inspect.signature(command, eval_str=True).bind(*values, **named))
        return functools.partial(command, *values, **named)

    bound.__signature__ = inspect.signature(command)  # type: ignore[attr-defined]
    return bound


def run_program(function: Callable, program: str, arguments: Sequence[str] | None = None) -> int:
    """Run a program that is one function, like a benchmark or a study; return its exit code.

    Args:
        function: its arguments are the options.
        program: how it is called, like "python -m experiments.benchmarks maze".
        arguments: what follows that on the command line; what this process was given unless set.
    """
    from qdenv.types import InputError

    interrupt.watch(program)
    try:
        parsed(lambda: tyro.cli(later(function), prog=program, args=arguments), program)()
        sys.stdout.flush()
    except InputError as error:
        print(f"qdenv: {error}", file=sys.stderr)
        return 2
    except BrokenPipeError:  # whoever read has read enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 0
