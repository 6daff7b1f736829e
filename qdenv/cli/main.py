"""The command line `qdenv`: choose a command, turn mistakes into one line and exit code 2.

The module of a command is imported when it is chosen: help and most refusals import no jax.
"""

import contextlib
import difflib
import errno
import itertools
import json
import logging
import os
import pkgutil
import re
import shlex
import shutil
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

# Before numpy is loaded: small eigenproblems on shared cores lose tenfold to BLAS threads.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import platformdirs

import qdenv
from qdenv.interrupt import EXIT_CODE, discard_unfinished, last_words

_WRITING = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EBADF)
_LONGEST = 200  # characters of a file's name in a message

# Group of help -> its commands, each a function of the package.
GROUPS = {
    group: names.split(", ")
    for group, names in {
        "plans": "render, check, repair, convert, layout human, layout tile, layout symbols",
        "traffic": "simulate, replay, compare, sweep, scalability, report, guide, audit-run",
        "search": "improve, zoo, presets, train, resume, plot, generate, series, explore, export, "
        "surrogate",
        "mazes": "train-agent, evaluate-agent, convert-agent",
        "shell": "completion",
    }.items()
}
_STUB = Path(qdenv.__file__).with_suffix(".pyi").read_text()  # says where functions are defined
_PLACES = {"completion": "qdenv.cli.completion:completion"} | {
    name: f"qdenv.{module}:{name}"
    for module, name in re.findall(r"from \.(ops\.\w+) import (\w+)", _STUB)
}
# Name of a command -> ``module:function``.
COMMANDS = {name: _PLACES[re.sub("[ -]", "_", name)] for names in GROUPS.values() for name in names}


def run(words: list[str]) -> int:
    """Run one command, given by what follows `qdenv` on the command line; return its exit code.

    Errors of the system (a folder without permission, a full disk, a closed output, no memory)
    become one line and exit code 2 here, wherever they happen. Raises SystemExit after help of a
    command.
    """
    if words[:1] == ["help"]:
        words = [*words[1:], "--help"]
    name, rest = split_name(words)
    try:
        try:
            return _run_command(name, rest) if name in COMMANDS else _run_general(name)
        finally:
            sys.stdout.flush()  # fails here, not when the interpreter ends
    except KeyboardInterrupt:
        print(last_words(), file=sys.stderr)
        return EXIT_CODE
    except BrokenPipeError:  # the reader has read enough
        # Python flushes standard output at the end, which must not fail again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (OSError, MemoryError, RuntimeError) as error:
        return _refuse(_describe(error))
    finally:
        discard_unfinished()


def split_name(words: list[str]) -> tuple[str, list[str]]:
    """Split a command line after the name of its command, which may be two words: layout human."""
    count = 2 if " ".join(words[:2]) in COMMANDS else 1
    return " ".join(words[:count]), words[count:]


def _run_general(name: str) -> int:
    """Print the version or the list of commands, or refuse what is not a command."""
    if name == "--version":
        print(qdenv.__version__)
    elif name not in ("", "-h", "--help"):
        return _refuse(_unknown(name))
    else:
        width = min(shutil.get_terminal_size().columns, 100) - 2
        print("usage: qdenv COMMAND ..., qdenv COMMAND --help (or --help-all), qdenv --version")
        for group, names in GROUPS.items():
            print(f"\n{group}")
            for command in names:
                text = f"{command:15} {summary_of(command)}"
                print(textwrap.fill(text, width, initial_indent="  ", subsequent_indent=" " * 18))
    return 0


def _refuse(message: str) -> int:
    """Print the line of a mistake, where it can be printed, and return its exit code."""
    with contextlib.suppress(OSError):
        print(f"qdenv: {message}", file=sys.stderr)
    return 2


def _describe(error: OSError | MemoryError | RuntimeError) -> str:
    """Return the line for an error of the system; any other error is raised again."""
    if isinstance(error, OSError):
        # Errors name their file unless an open one is written to; results have messages of their
        # own (`write_atomically`).
        place = error.filename or ("standard output" if error.errno in _WRITING else "the system")
        message = f"{str(place)[:_LONGEST]}: {error.strerror or error}"
    elif isinstance(error, MemoryError) or re.search(
        "RESOURCE_EXHAUSTED|Out of memory", str(error)
    ):
        message = "this takes more memory than there is: choose smaller numbers"
    else:
        raise error
    from qdenv.types import InputError  # imports numpy

    return str(InputError(message))  # printable


def _unknown(name: str) -> str:
    """Return what is wrong with a name that is not a command."""
    if name.startswith("-"):
        return f"give a command before {name}: `qdenv --help` lists them"
    if longer := [known for known in COMMANDS if known.startswith(f"{name} ")]:
        return f"{name} needs another word: `qdenv {'`, `qdenv '.join(longer)}`"
    close = difflib.get_close_matches(name, COMMANDS, 1)
    guess = f"did you mean `qdenv {close[0]}`?" if close else "`qdenv --help` lists the commands"
    return f"unknown command {name!r}: {guess}"


def summary_of(command: str) -> str:
    """Return the first line of a command's docstring, from its source: imports take seconds."""
    module, _, name = COMMANDS[command].partition(":")
    path = Path(__file__).parents[2].joinpath(*module.split(".")).with_suffix(".py")
    _, _, function = path.read_text().partition(f"\ndef {name}(")
    return function.split('"""')[1].partition("\n")[0]


def parse_command(name: str, typed: list[str]) -> tuple[Callable, Any]:
    """Parse what follows the name of a command; return its operation and a `parser.command`.

    Raises InputError for a mistake, SystemExit after help.
    """
    # They import numpy and the parser: not for help.
    from qdenv.cli.parser import command, parse
    from qdenv.cli.rules import Choices, make_rules
    from qdenv.types import InputError

    if odd := [word for word in typed if word.encode(errors="replace") != os.fsencode(word)]:
        raise InputError(f"{odd[0]}: not UTF-8: give the file another name")
    operation = pkgutil.resolve_name(COMMANDS[name])
    program, words = f"qdenv {name}", _name_pictures(typed)
    # Which options there are depends on what is chosen by name: that is read first.
    chosen, rest = parse(Choices, words, program, partly=True)
    return operation, parse(command(operation), words, program, make_rules(chosen, rest))


def _run_command(name: str, typed: list[str]) -> int:
    """Parse a command line, run the operation and write its facts; return the exit code."""
    from qdenv.cli.rules import flat
    from qdenv.io.files import tidy, write_json
    from qdenv.ops.output import AUTO, UnsolvedError, place
    from qdenv.types import InputError

    try:
        operation, stated = parse_command(name, typed)
        bound, to_stdout = stated.arguments, stated.json == Path("-")
        facts_file = None if to_stdout else stated.json
        arguments, known = bound.arguments, bound.signature.parameters
        if not known.keys().isdisjoint(("out", "study")):
            # In Python nothing is written unless named. Studies share options, this one as well.
            outputs = arguments.setdefault("study", {}) if "study" in known else arguments
            outputs["out"] = outputs.get("out") or AUTO
        # A page shows the command line that makes it again: as typed.
        if "again" in known:
            arguments["again"] = shlex.join(["qdenv", *name.split(), *typed])
        if isinstance(layouts := arguments.get("layouts"), tuple):  # named twice, it is one
            arguments["layouts"] = tuple(dict.fromkeys(layouts))
        # What is read is compared where places are chosen.
        named = arguments | arguments.get("study", {}) | {"json": facts_file}
        written: dict[str, str] = {}  # file -> name of the option
        for option, one in named.items():
            read = one == AUTO or option in ("layout", "run", "plan", "model", "checkpoint")
            if read or not isinstance(one, Path):
                continue
            if written.setdefault(os.path.realpath(one), option) != option:
                raise InputError(f"{one}: named twice: give each output a name of its own")
        if replaced := set(filter(os.path.isfile, written)):
            for beside in _files_beside(filter(os.path.exists, map(str, flat(arguments)))):
                if os.path.realpath(beside) in replaced:
                    raise InputError(f"{beside}: that is what is read: choose another name")
        target = place(facts_file, "facts.json", inputs=flat(arguments))
        # Nothing but the facts is written to standard output if they are written there.
        with contextlib.redirect_stdout(sys.stderr if to_stdout else sys.stdout), _printing():
            try:
                result = operation(*bound.args, **bound.kwargs)
            except UnsolvedError as error:
                result = error
        facts = result if isinstance(result, dict) else getattr(result, "facts", {})
        facts = tidy({**facts, "command": name, "qdenv": qdenv.__version__})
        if to_stdout:
            print(json.dumps(facts, indent=1))
        elif target:
            write_json(target.path, facts)
            print(target)
        if isinstance(result, UnsolvedError):
            raise result
        return getattr(result, "exit_code", 0)
    except InputError as error:
        return _refuse(str(error))


class _Printer(logging.Handler):
    """Print what operations log, above a progress bar if there is one."""

    def emit(self, record: logging.LogRecord) -> None:
        bars = sys.modules.get("tqdm")
        (bars.tqdm.write if bars else print)(record.getMessage())
        sys.stdout.flush()  # a reader behind a pipe waits for it, too


@contextlib.contextmanager
def _printing() -> Iterator[None]:
    log, printer = logging.getLogger("qdenv"), _Printer()
    level, log.propagate = log.level, False
    log.addHandler(printer)
    log.setLevel(logging.INFO)
    try:
        yield
    finally:
        log.removeHandler(printer)
        log.setLevel(level)
        log.propagate = True


def _name_pictures(words: list[str]) -> list[str]:
    """Name the pictures that have no name `AUTO`; a layout may follow: `--plot plan.txt`."""
    from qdenv.ops.output import AUTO, FILMS, PICTURES

    # Some of these are refused, with a reason.
    endings = (*PICTURES, *FILMS, ".jpg", ".jpeg", ".webp", ".tif", ".bmp")
    named: list[str] = []
    for word, following in itertools.pairwise([*words, "-"]):
        named.append(word)
        optional = word in ("--plot", "--gif", "--mp4")
        if optional and following != str(AUTO) and Path(following).suffix.lower() not in endings:
            named.append(str(AUTO))
    return named


def main() -> None:
    """Run the command line; programs are kept between calls where they hold no host callback."""
    if sys.stderr is None:  # it is closed
        sys.stderr = open(os.devnull, "w")  # noqa: SIM115 (until the end)
    if sys.stdout is None:
        os._exit(_refuse("standard output is closed: `> /dev/null` throws it away"))
    # Names of files need not be text; what a terminal cannot show is spelt.
    for stream in (sys.stdout, sys.stderr):
        stream.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]
    cache = platformdirs.user_cache_path("qdenv") / "jax"
    if cache.is_absolute():  # else this user's home is unknown
        # Read when jax is imported, which is later. By itself jax keeps what took a second.
        chosen = os.environ.get("JAX_COMPILATION_CACHE_DIR") or str(cache)
        os.environ["JAX_COMPILATION_CACHE_DIR"] = chosen
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.1")
    # Everything is computed in single precision, whatever other programs here prefer.
    os.environ["JAX_ENABLE_X64"] = "0"
    try:
        code = run(sys.argv[1:])
    except SystemExit as stop:  # help was printed
        code = stop.code if isinstance(stop.code, int) else 0
    # Everything is written. The rest of the interpreter's end would take time, and crash on Ctrl-C.
    os._exit(code)


def _files_beside(inputs: Iterable[str]) -> Iterator[Path]:
    """List what is read with files and folders: what lies beside them, or is named in them."""
    from qdenv.io.files import RUN_FILES
    from qdenv.io.layouts import read_drawing
    from qdenv.types import InputError

    for path in map(Path, inputs):
        if not path.is_file():
            yield from map(path.joinpath, RUN_FILES)
            continue
        yield from map(path.with_suffix, [".toml"] + [".map"] * (path.suffix.lower() == ".scen"))
        with contextlib.suppress(InputError):  # it is not a layout
            facts = read_drawing(path).details.get("facts", {})
            named = f"{facts.get('keep', '')}+{facts.get('demand', '')}".split("+")
            yield from map(path.parent.joinpath, named)
