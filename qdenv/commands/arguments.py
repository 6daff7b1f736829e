"""Command lines as lists of words, before the parser reads them."""

from collections.abc import Sequence

from qdenv.types import InputError


def take(arguments: Sequence[str], option: str) -> tuple[str | None, list[str]]:
    """Take one option and its value out of a command line.

    Returns:
        the last value given (None where there is none), and the other arguments.

    Raises:
        InputError: the option is the last word.
    """
    value, rest = None, list(arguments)
    while option in rest:
        at = rest.index(option)
        if at + 1 == len(rest):
            raise InputError(f"{option} needs a value")
        value = rest[at + 1]
        del rest[at : at + 2]
    for argument in [one for one in rest if one.startswith(f"{option}=")]:
        value = argument.partition("=")[2]
        rest.remove(argument)
    return value, rest
