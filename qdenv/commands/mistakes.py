"""What the parser of the command line says of a mistake, in one line."""

import difflib
import re
from collections.abc import Iterable

SIDES = "│| "  # of the frame, on terminals that know its characters and on others
RULE = re.compile(r"^[╭╰+]|^[─-]{5,}$")
TITLES = (
    "Unrecognized options",
    "Required options",
    "Value error",
    "Invalid choice",
    "Missing argument",
)


def one_line(box: str, program: str) -> str:
    """Reduce the parser's framed message to one line that says what to do.

    Args:
        box: what it printed.
        program: the command, like "qdenv simulate".
    """
    lines = [line.strip(SIDES) for line in box.splitlines()]
    # On a terminal the title is part of the frame, elsewhere a line of its own.
    ruled = ["\0" if RULE.search(line) else line for line in lines]
    parts = [part.strip() for part in " ".join(" ".join(ruled).split()).split("\0")]
    said, *hints = [part for part in parts if part and part not in TITLES] or [box.strip()]
    if match := re.match(r"Error parsing \S*__tyro\S*: (.*)", said):
        return match[1]  # said by the settings themselves
    return f"{_reworded(said, ' '.join(hints))} (`{program} --help` lists the options)"


def _reworded(said: str, hints: str) -> str:
    """Say a message of the parser as the other messages of the program are said."""
    if match := re.match(r"Unrecognized options: (\S+?),?(?: |$)", said):
        word = match[1]
        close = re.search(r"Perhaps you meant: (--[\w.-]+)", hints)
        what = "option" if word.startswith("-") else "argument"
        return f"unknown {what} {word}" + (f": did you mean {close[1]}?" if close else "")
    if match := re.match(r"Error parsing (\S+): invalid literal for int.*: ('.*')", said):
        return f"{match[1]} {match[2]} is no whole number"
    if match := re.match(r"Error parsing (\S+): no type matching (\S+) .* from \['(.*?)'", said):
        kinds = match[2].replace("{None}|", "").lower().replace("int", "whole number")
        return f"{match[1]} {match[3]!r} is no {kinds.replace('float', 'number')}"
    if match := re.match(r"Error parsing (\S+): Could not find valid parse .*: \[(.*)\]", said):
        words = match[2].replace("'", "").replace(",", "")
        return f"{match[1]} {words} has not the form that help shows"
    if match := re.match(r"Error parsing (\S+): could not convert string to float: ('.*')", said):
        return f"{match[1]} {match[2]} is no number"
    if match := re.match(
        r"invalid choice '(.*)' for argument '(\S+)'\. Expected one of \((.*)\)", said
    ):
        return f"{match[2]} {match[1]}: choose one of {match[3].replace(chr(39), '').strip(' ,')}"
    if match := re.match(r"Missing value for argument '(\S+?)'\.", said):
        return f"{match[1].split(',')[0]} needs a value"
    if match := re.match(r"Missing from .*?: (\S+) (?:[A-Z|{}\[\].]+ )*(.*?)\(required\)", said):
        what = match[2].strip(" .")
        return f"{match[1]} is missing: {what}" if match[1][:2] == "--" else f"{what} is missing"
    return said.rstrip(".")


def unknown_command(word: str, known: Iterable[str]) -> str:
    """Say that no command has this name, and which one may have been meant."""
    known = list(known)
    longer = [name for name in known if name.startswith(f"{word} ")]
    close = difflib.get_close_matches(word, known, 1)
    if longer:
        return f"{word} what? `qdenv {'`, `qdenv '.join(longer)}`"
    guess = f"did you mean `qdenv {close[0]}`?" if close else "`qdenv --help` lists the commands"
    return f"unknown command {word!r}: {guess}"
