"""The command line `qdenv`: choose a command, turn mistakes into one line and exit code 2.

A command is imported when it is chosen: help is read in less time than jax takes to load.
"""

import contextlib
import errno
import importlib
import itertools
import os
import sys
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from typing import Any

# Before numpy is loaded: small eigenproblems on shared cores lose tenfold to BLAS threads.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import tyro

from qdenv.commands.catalogue import COMMANDS, summary_of
from qdenv.commands.mistakes import unknown_command
from qdenv.commands.parsing import later, parsed
from qdenv.interrupt import EXIT_CODE, last_words

AUTO = "auto"  # the value of an option like --plot that was given none


def run(arguments: list[str]) -> int:
    """Run one command and return its exit code.

    Args:
        arguments: what follows `qdenv` on the command line.
    """
    if arguments[:1] == ["--version"]:
        print(metadata.version("qdenv"))
        return 0
    if not arguments or arguments == ["help"]:
        arguments = ["--help"]
    elif arguments[0] == "help":
        arguments = [*arguments[1:], "--help"]
    if " ".join(arguments[:2]) in COMMANDS:
        arguments = [" ".join(arguments[:2]), *arguments[2:]]
    # What prints completion for a shell asks for the options of every command.
    completion = any(argument.startswith("--tyro-") for argument in arguments)
    try:
        if arguments[0] in COMMANDS or completion:
            return _run_loaded(arguments, list(COMMANDS) if completion else arguments[:1])
        if not arguments[0].startswith("-"):
            return _complain(unknown_command(arguments[0], COMMANDS))
        if arguments[0] not in ("-h", "--help"):
            return _complain(f"give a command before {arguments[0]}: `qdenv --help` lists them")
        _parse({name: summary_of(name) for name in COMMANDS}, arguments)
    except KeyboardInterrupt:
        print(last_words(), file=sys.stderr)
        return EXIT_CODE
    except BrokenPipeError:  # whoever read has read enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 0


def _run_loaded(arguments: list[str], wanted: list[str]) -> int:
    """Import the wanted commands and run the one that is named."""
    from qdenv.commands.output import place, words_aside
    from qdenv.commands.planners import OPTIONS
    from qdenv.types import InputError

    try:
        arguments = with_values(arguments)
        commands = {name: summary_of(name) for name in COMMANDS}
        for name in wanted:
            given = arguments[1:] if [name] == arguments[:1] else []
            commands[name] = _loaded(name, given)
        chosen = _parse(commands, arguments, OPTIONS)
        facts = _facts_place(arguments)
        if facts and facts != "-":
            place(Path(facts), "facts.json", inputs=_files_but(facts, arguments))
        with words_aside() if facts == "-" else contextlib.nullcontext():
            code = chosen()
    except InputError as error:
        return _complain(error)
    except OSError as error:  # whatever is asked of a file, it can have no such name
        if error.errno != errno.ENAMETOOLONG:
            raise
        return _complain(InputError(f"{str(error.filename)[:99]}...: too long for a file's name"))
    return code if isinstance(code, int) else 0


def _facts_place(arguments: list[str]) -> str | None:
    """Find what follows the last `--json`, which all commands take alike."""
    found = None
    for word, following in itertools.pairwise([*arguments, ""]):
        if word == "--json":
            found = following
        elif word.startswith("--json="):
            found = word.partition("=")[2]
    return found


def _files_but(facts: str, arguments: list[str]) -> list[Path]:
    """List the files that a command line names beside the one for its facts."""
    others = list(arguments)
    others.remove(facts if facts in others else f"--json={facts}")
    if facts in others:  # it may not exist yet
        from qdenv.types import InputError

        raise InputError(f"{facts}: named twice: give the facts a file of their own")
    return [Path(word) for word in others if not word.startswith("-")]


def _complain(mistake: object) -> int:
    print(f"qdenv: {mistake}", file=sys.stderr)
    return 2


def with_values(arguments: list[str]) -> list[str]:
    """Give `--plot` and its like without a value one: the command then names the picture."""
    whole: list[str] = []
    for word, following in zip(arguments, [*arguments[1:], "-"], strict=True):
        whole.append(word)
        # A layout may follow that is no picture: `simulate --plot plan.txt`.
        drawn = word in ("--plot", "--gif", "--mp4")
        if drawn and (following.startswith("-") or not _names_picture(following)):
            whole.append(AUTO)
    return whole


def _names_picture(word: str) -> bool:
    endings = (".png", ".svg", ".pdf", ".gif", ".mp4", ".jpg", ".jpeg", ".webp", ".tif", ".bmp")
    return word == AUTO or Path(word).suffix.lower() in endings  # some are refused, with a reason


def _parse(
    commands: dict[str, Callable],
    arguments: list[str],
    names: tyro.constructors.ConstructorRegistry | None = None,
) -> Callable[[], Any]:
    """Choose a command and bind its arguments; nothing runs yet."""
    return parsed(
        lambda: tyro.extras.subcommand_cli_from_dict(
            {name: later(command) for name, command in commands.items()},
            prog="qdenv",
            args=arguments,
            config=(tyro.conf.AvoidSubcommands,),
            registry=names,
        ),
        f"qdenv {arguments[0]}" if arguments[0] in COMMANDS else "qdenv",
    )


def _loaded(command: str, given: list[str]) -> Callable:
    """Import a command, with the options that follow from what is chosen in its arguments."""
    from qdenv.commands import choices

    name, _, function = COMMANDS[command].partition(":")
    module = importlib.import_module(name)
    bind: Callable[[Callable, list[str]], Callable] = getattr(module, "bind", choices.bind)
    return bind(getattr(module, function), given)


def main() -> None:
    """Run the command line; programs are kept between calls where they hold no host callback."""
    cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "qdenv" / "jax"
    # Read when jax is imported, which is later. By itself jax keeps what took a second.
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(cache))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.1")
    try:
        code = run(sys.argv[1:])
    except SystemExit as stop:  # help was printed
        code = stop.code if isinstance(stop.code, int) else 0
    with contextlib.suppress(BrokenPipeError):
        sys.stdout.flush()
    # All is written. What follows would take its time, and answer Ctrl-C by dying of it.
    os._exit(code)
