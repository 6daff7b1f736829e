"""notes.csv: what an algorithm says of itself after each iteration, like a surrogate's losses."""

import csv
import math
from collections.abc import Mapping
from pathlib import Path
from typing import SupportsFloat

from qdenv.files import write_csv
from qdenv.types import InputError

NOTES = "notes.csv"
Note = dict[str, float]  # numbers by name; NaN where there was nothing to say


def note_of(iteration: int, batch: int, said: Mapping[str, SupportsFloat]) -> Note:
    """Write an iteration's note, with what to plot it over."""
    place = {"iteration": float(iteration), "evaluations": float(iteration * batch)}
    return place | {name: float(value) for name, value in said.items()}


def write_notes(path: Path, notes: list[Note]) -> None:
    """Replace notes.csv; an algorithm that says nothing has no such file."""
    if not notes or len(notes[0]) <= 2:
        return
    rows = [
        ["" if math.isnan(value) else f"{value:g}" for value in note.values()] for note in notes
    ]
    write_csv(path, list(notes[0]), rows)


def read_notes(path: Path) -> list[Note]:
    """Read notes.csv; nothing where there is none.

    Raises:
        InputError: the file is damaged.
    """
    if not path.exists():
        return []
    try:
        with path.open(newline="") as file:
            return [
                {name: float(value) if value else math.nan for name, value in row.items()}
                for row in csv.DictReader(file, strict=True)
            ]
    except (OSError, ValueError, TypeError, csv.Error) as error:
        raise InputError(f"{path}: cannot be read ({error})") from error
