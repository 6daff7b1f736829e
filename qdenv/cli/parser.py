"""From a command line to a call: tyro reads the types, a mistake becomes one line."""

import ast
import contextlib
import dataclasses
import difflib
import functools
import inspect
import io
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Union, Unpack, get_args, get_origin, get_type_hints

import tyro
from tyro import _errors as events
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from qdenv.cli.help import ALL, compacted
from qdenv.ops.options import Mark, option
from qdenv.ranges import check_range
from qdenv.types import InputError

MARKERS = (tyro.conf.AvoidSubcommands,)
SPEC = "COMPLETION_SPEC = "  # begins the line of tyro's completion script with all options
_JSON = tyro.conf.arg(metavar="FILE", help="file to write the facts to; - is standard output")


def parse(
    target: Any, words: Sequence[str], program: str, rules: Any = None, partly: bool = False
) -> Any:
    """Make a value of a type, or call a function, with the words behind the name of a program.

    `rules` are for types of our own (see `qdenv.cli.rules`), by default those for numbers alone.
    With `partly`, unknown words are returned as well; otherwise InputError refuses them.
    """
    rules = rules or number_rules()

    def refuse(event: Any) -> None:
        if message := _message(event, target, rules):
            raise InputError(message)

    about = inspect.getdoc(target) or ""
    given = ["--help" if word == ALL else word for word in words]
    helps = not partly and not {"-h", "--help"}.isdisjoint(given)
    # The hook is no public interface of tyro yet. Of an event that we do not know, tyro prints a
    # longer text and leaves with the same exit code.
    with (
        compacted(about, ALL in words) if helps else contextlib.nullcontext(),
        events.on_parse_error(refuse),
    ):
        return tyro.cli(  # type: ignore[call-overload]
            target,
            prog=program,
            # Of a docstring, what comes before its sections.
            description=re.split(r"\n\n(?:Args|Returns|Examples):", about)[0],
            args=given,
            config=MARKERS,
            registry=rules,
            add_help=not partly,
            return_unknown_args=partly,
        )


def _message(event: Any, target: Any, rules: Any) -> str:
    """Return the line for a mistake; "" for one that is unknown here."""
    listed = f" (`{event.prog} --help` lists the options)"
    if isinstance(event, events.UnrecognizedArgs):
        word = event.tokens[0].partition("=")[0]
        if not word.startswith("-"):
            return f"unknown argument {word}{listed}"
        # tyro lists the options of a program nowhere but in its script for shells.
        with contextlib.redirect_stdout(io.StringIO()) as script, contextlib.suppress(SystemExit):
            parse(target, ["--tyro-print-completion", "bash"], "qdenv", rules)
        options = completion_spec(script.getvalue())["options"]
        flags = [name for option in options for name in option["flags"]]
        # --lanes for --planner.lanes is less of a mistake than any other letter.
        alike = [name for name in flags if name.rpartition(".")[2] == word.lstrip("-")]
        close = [*alike, *difflib.get_close_matches(word, flags, 1)]
        return f"unknown option {word}" + (f": did you mean {close[0]}?" if close else "") + listed
    if isinstance(event, events.InstantiationFailure):
        message = event.message.partition("\n")[0]
        if event.argument is None:  # a record refused its values
            return message
        name = _name_of(event.argument)
        if message.startswith("must be"):
            return f"{name} {message}{listed}"
        if "parse" in message or "type matching" in message:  # tyro's own words
            return f"{name} does not have the form {event.argument.lowered.metavar}{listed}"
        return message
    if isinstance(event, events.InvalidChoice):
        known = ", ".join(event.choices)
        return f"{_name_of(event.argument)} {event.value}: choose one of {known}{listed}"
    if isinstance(event, events.BadValue):
        return f"{_name_of(event.argument)} needs a value{listed}"
    if isinstance(event, events.MissingArgs):
        missing = event.missing_arguments[0].arg
        return f"{_name_of(missing)} is missing: {help_of(missing.field).rstrip('.')}{listed}"
    return ""


def help_of(field: Any) -> str:
    """Return the help of a field of tyro's, which may be a function that reads it in the source."""
    return (field.helptext() if callable(field.helptext) else field.helptext) or ""


def _name_of(argument: Any) -> str:
    lowered = argument.lowered
    names = [lowered.metavar] if argument.is_positional() else lowered.name_or_flags
    return " or ".join(map(str, names))


def completion_spec(script: str) -> dict[str, Any]:
    """Return the description of all options in tyro's completion script for a program."""
    line = next(line for line in script.splitlines() if line.startswith(SPEC))
    return dict(ast.literal_eval(line.removeprefix(SPEC)))


def number_rules() -> ConstructorRegistry:
    """Make the rules by which numbers are read: a mistake is refused in plain words."""
    rules = ConstructorRegistry()

    @rules.primitive_rule
    def number(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec | None:
        parts = get_args(info.type) if get_origin(info.type) in (Union, UnionType) else (info.type,)
        kinds = [get_args(one)[0] if get_origin(one) is Annotated else one for one in parts]
        kind = next((one for one in kinds if one is not type(None)), None)
        if kind not in (int, float) or len(kinds) > 2:
            return None

        def read(word: str) -> Any:
            try:
                return kind(word)
            except ValueError:
                noun = "an integer" if kind is int else "a number"
                raise ValueError(f"must be {noun}, not {word!r}") from None

        return option(kind.__name__.upper(), read)

    return rules


def command(operation: Callable) -> Any:
    """Make the type of a command: a record of `json` and the `arguments` of a typed function.

    The latter are `inspect.BoundArguments`; the function's docstring explains them.
    """
    fields: list[Any] = [
        ("arguments", Annotated[Any, tyro.conf.arg(name="", constructor=bind(operation))]),
        ("json", Annotated[Path | None, _JSON], None),
    ]
    record = dataclasses.make_dataclass("Command", fields)
    record.__doc__ = operation.__doc__
    return record


def bind(function: Callable) -> Callable[..., inspect.BoundArguments]:
    """Make a function of the same arguments that checks their ranges and returns them."""
    signature, hints = inspect.signature(function), get_type_hints(function, include_extras=True)

    @functools.wraps(function)
    def bound(*values: Any, **named: Any) -> inspect.BoundArguments:
        arguments = signature.bind(*values, **named)
        stated, kinds = dict(arguments.arguments), hints
        for name, kind in hints.items():
            if get_origin(kind) is Unpack:  # **options: Unpack[Record]
                stated |= stated.pop(name, {})
                kinds = hints | get_type_hints(get_args(kind)[0], include_extras=True)
        for name, value in stated.items():
            check_range(name, value, kinds[name])
        return arguments

    # tyro takes defaults from the signature, the call those of the function itself.
    parameters = [
        one.replace(default=True)
        if Mark.TRUE in getattr(hints.get(name), "__metadata__", ())
        else one
        for name, one in signature.parameters.items()
    ]
    bound.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    return bound
