"""What commands leave behind: files that are named, said, and never one over another."""

import contextlib
import json
import sys
from collections.abc import Iterable, Iterator, Mapping
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TextIO

import tyro

from qdenv.io.files import tidy, write_json
from qdenv.types import InputError

PICTURES = (".png", ".svg", ".pdf")
MOVING_PICTURES = (".gif", ".mp4")

# How a command takes `--json FILE`; "-" is standard output, where nothing else is written then.
JsonFile = Annotated[Path | None, tyro.conf.arg(name="json", metavar="FILE")]


class Place(NamedTuple):
    """Where a result goes."""

    path: Path  # the file
    replaces: bool  # there is such a file already, and the command line named it

    def __str__(self) -> str:
        """Say the place as commands print it."""
        return f"{self.path} (replaced)" if self.replaces else str(self.path)

    def beside(self, ending: str, suffix: str = "") -> "Place":
        """Choose the place of another result beside this one: the same name, another ending."""
        path = self.path.with_name(f"{self.path.stem}{suffix}{ending}")
        return Place(path, path.exists())


def place(
    out: Path | None,
    default: str,
    endings: Iterable[str] = (),
    inputs: Iterable[Path] = (),
) -> Place:
    """Choose where a result goes, before any work is done.

    Args:
        out: what the command line says; None takes `default`, or the next free name like it.
        default: name in the current folder.
        endings: those the file may have; empty for data, which any but a picture's may name.
        inputs: files that are read, and never written over.

    Raises:
        InputError: the ending is none of them, or the place is a folder or an input.
    """
    endings = tuple(endings)
    if out is None:
        return Place(_free(Path(default)), False)
    ending = out.suffix.lower()
    if endings and ending not in endings:
        raise InputError(f"{out}: give a name that ends in {' or '.join(endings)}")
    if not endings and ending in PICTURES + MOVING_PICTURES:
        better = out.with_suffix(Path(default).suffix)
        raise InputError(
            f"{out}: that is a picture's name: name the data {better}, pictures are drawn beside it"
        )
    if out.is_dir():
        raise InputError(f"{out}: that is a folder: name a file in it, like {out / default}")
    if any(out.exists() and one.exists() and out.samefile(one) for one in inputs):
        raise InputError(f"{out}: that is what is read: choose another name")
    return Place(out, out.exists())


def _free(path: Path) -> Path:
    """Find the first name of this kind that nothing has: plan.json, plan-2.json, ..."""
    number, free = 1, path
    while free.exists():
        number += 1
        free = path.with_name(f"{path.stem}-{number}{path.suffix}")
    return free


def write_facts(path: Path | None, command: str, facts: Mapping[str, Any], **settings: Any) -> None:
    """Write what a command found out as JSON that explains itself, and say where.

    Nothing without a path. The command line has checked the place before the command began.

    Args:
        path: the file, or "-" for standard output.
        command: its name.
        facts: JSON-ready values, or numpy's.
        settings: what they were found with, each option by its name.

    Raises:
        InputError: the place cannot be written to.
    """
    if path is None:
        return
    about = {"command": command, "qdenv": metadata.version("qdenv"), "settings": settings}
    content = tidy({**facts, **about})
    if str(path) == "-":
        print(json.dumps(content, indent=1), file=_answers or sys.stdout)
    else:
        target = place(path, "facts.json")
        write_json(target.path, content)
        print(target)


_answers: TextIO | None = None  # standard output, while words go elsewhere


@contextlib.contextmanager
def words_aside() -> Iterator[None]:
    """Leave standard output to the facts alone; what commands say goes to standard error."""
    global _answers
    _answers = sys.stdout
    try:
        with contextlib.redirect_stdout(sys.stderr):
            yield
    finally:
        _answers = None
