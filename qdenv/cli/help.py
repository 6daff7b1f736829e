"""Help of a command on one screen: an example, what most people need; the rest by `--help-all`."""

import contextlib
import functools
import io
import os
import re
import shutil
import textwrap
from collections.abc import Iterator

ALL = "--help-all"
_wrap = functools.partial(textwrap.fill, break_on_hyphens=False)  # names stay whole
_LEFT = 26  # characters of the column of options
# What the short help leaves out, beside the settings of planners: each has a default that suits.
_RARE = re.compile(
    "--(width|format|audit|stop|seconds-per-step|pick|drop|shares|measures|frames|progress|moves"
    "|executor|scheduler|workers|cross-aisle|both-sides|task-rate)"
)
# Settings of a search that the short help lists; all others are left out.
_SEARCHED = re.compile(
    "--(domain|planner|algorithm|rows|cols|robots|timesteps|shelves|stations|evaluations|seed"
    "|start)"
)
# What tyro adds to help and says nothing: there is no default, or the text names it.
_NOTHING = re.compile(
    r"\.? *\((?:required|default: (?:None|\[\]|\(\)|'')?)\)|\.(?= \(default)|\.$|(?<=`)`|`(?=`)"
)


def example_of(about: str) -> str:
    """Return the command line in the section "Examples" of a docstring; "" if there is none."""
    return about.partition("\n\nExamples:\n")[2].partition("\n\n")[0].strip().strip("`")


@contextlib.contextmanager
def compacted(about: str, everything: bool) -> Iterator[None]:
    """Print help that tyro prints within in a shorter form; `about` is the program's docstring."""
    # In UTF-8, else tyro draws no boxes, by which its options are found.
    columns, shown = os.environ.get("COLUMNS"), io.TextIOWrapper(io.BytesIO(), "utf-8")
    try:
        os.environ["COLUMNS"] = "129"  # more than that, and tyro sets it in columns
        with contextlib.redirect_stdout(shown):
            yield
    finally:
        os.environ.pop("COLUMNS")
        os.environ |= {} if columns is None else {"COLUMNS": columns}
        shown.seek(0)
        print(_compact(shown.read(), example_of(about), everything))


def _compact(text: str, example: str, everything: bool) -> str:
    """Return help in a shorter form; without `everything`, what few people need is counted."""
    head, *groups = text.split("\n╭─ ")
    usage, _, about = head.replace(" [-h]", "").strip().partition("\n\n")
    lines = [usage, "", *(_fill(part, "") for part in about.split("\n\n"))]
    lines += ["", f"  $ {example}"] if example else []
    hidden = 0
    for group in groups:
        title, entries, shown = group.partition(" ─")[0], _entries(group), []
        for names, help_text in entries:
            flags = [word.rstrip(",") for word in names.split() if word.startswith("--")]
            if title == "settings options":  # of a search
                rare = not any(map(_SEARCHED.fullmatch, flags))
            else:
                rare = any("." in flag or _RARE.fullmatch(flag) for flag in flags)
                rare |= title != "options" and "--domain" in flags  # that of the plan suits
            if "--help" in flags:
                continue
            if rare and not everything:
                hidden += 1
                continue
            help_text = _NOTHING.sub("", help_text).replace("['best']", "best")
            shown.append(_fill(help_text, names.replace("{None}|", "").replace("{None,", "{")))
        lines += ["", *shown] if shown else []
    if hidden:
        lines += ["", _fill(f"{hidden} more option{'s' * (hidden > 1)}", ALL)]
    return "\n".join(lines)


def _entries(group: str) -> list[tuple[str, str]]:
    """List the options in a box: how each is typed, and its help."""
    entries: list[list[str]] = []
    for line in group.splitlines():
        content = line[1:-1].rstrip()
        if not line.startswith("│"):
            continue
        if content.startswith(" ──"):  # what stands before describes the group
            entries.clear()
            continue
        if content.startswith("   "):
            entries[-1].append(content.strip())
        elif entries and entries[-1][0].startswith("-") and not content.startswith(" -"):
            entries[-1][0] += content.strip()  # a long list of names
        else:
            names, _, begin = content.strip().partition("  ")
            entries.append([names, begin.strip()])
    return [(names, " ".join(parts).strip()) for names, *parts in entries]


def _fill(text: str, names: str) -> str:
    """Wrap text to the terminal, beside the names of an option, or below them if these are long."""
    width = min(shutil.get_terminal_size().columns, 100)
    if not names:
        return _wrap(" ".join(text.split()), width)
    indent = " " * (_LEFT + 2)
    if len(names) > _LEFT - 2 or not text:
        if len(names) > width - 4:
            names = names.replace(",", ", ")
        above = _wrap(names, width, initial_indent="  ", subsequent_indent="      ")
        below = _wrap(text, width, initial_indent=indent, subsequent_indent=indent)
        return f"{above}\n{below}" if text else above
    return _wrap(text, width, initial_indent=f"  {names:{_LEFT}}", subsequent_indent=indent)
