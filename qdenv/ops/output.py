"""What operations leave: lines of text, files that replace nothing by surprise, tables."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from qdenv.types import InputError

# Operations log what they find, line by line. The command line prints these lines; in Python they
# are silent unless logging is configured: logging.basicConfig(level="INFO", format="%(message)s").
log = logging.getLogger("qdenv")

AUTO = Path("auto")  # an output that was requested without a name; the operation chooses one
PICTURES = (".png", ".svg", ".pdf")
FILMS = (".gif", ".mp4")


def say(*lines: object) -> None:
    """Log lines of text."""
    for line in lines:
        log.info("%s", line)


class Place(NamedTuple):
    """A file to write."""

    path: Path  # the file
    replaces: bool  # it exists already, and was named by the user

    def __str__(self) -> str:
        """Return the path as commands print it."""
        return f"{self.path} (replaced)" if self.replaces else str(self.path)

    def beside(self, ending: str, suffix: str = "") -> Place:
        """Return the place of another result: the same name, another ending."""
        path = self.path.with_name(f"{self.path.stem}{suffix}{ending}")
        return Place(path, path.exists())


def place(
    out: str | Path,
    default: str,
    endings: Iterable[str] = (),
    inputs: Iterable[Any] = (),
) -> Place:
    """Choose where a result goes, before any work is done.

    Args:
        out: the file; `AUTO` takes `default`, or the next free name like it (plan-2.json).
        default: name in the current folder.
        endings: those the file may have; empty for data, which any but a picture's may name.
        inputs: files that are read and must not be overwritten; other values are ignored.

    Raises:
        InputError: the ending is none of them, or the place is a folder or an input.
    """
    path, endings = Path(out), tuple(endings)
    if path == AUTO:
        return Place(_free(Path(default)), False)
    ending = path.suffix.lower()
    if endings and ending not in endings:
        raise InputError(f"{path}: give a name that ends in {' or '.join(endings)}")
    if not endings and ending in PICTURES + FILMS:
        better = path.with_suffix(Path(default).suffix)
        raise InputError(
            f"{path}: that is a picture's name: name the data {better}, pictures are drawn beside "
            "it"
        )
    if path.is_dir():
        raise InputError(
            f"{path}: that is a folder: name a file in it, like {path / Path(default).name}"
        )
    if path.exists() and any(
        one.exists() and path.samefile(one) for one in map(Path, _paths(inputs))
    ):
        raise InputError(f"{path}: that is what is read: choose another name")
    return Place(path, path.exists())


def place_folder(out: str | Path, default: str) -> Path:
    """Choose the folder of several results.

    Raises:
        InputError: it is a file.
    """
    folder = _free(Path(default)) if Path(out) == AUTO else Path(out)
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: that is a file: name a folder")
    return folder


def _paths(values: Iterable[Any]) -> list[str | Path]:
    return [value for value in values if isinstance(value, str | Path)]


def _free(path: Path) -> Path:
    """Return the first name of this kind that is not in use: plan.json, plan-2.json, ..."""
    number, free = 1, path
    while free.exists():
        number += 1
        free = path.with_name(f"{path.stem}-{number}{path.suffix}")
    return free


def format_table(rows: Iterable[Sequence[Any]]) -> list[str]:
    """Align the columns of a table to the left.

    Args:
        rows: of equal length, the head first.
    """
    cells = [[str(cell) for cell in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    return [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in cells
    ]
