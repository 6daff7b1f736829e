"""notes.csv: what an algorithm says of itself after each iteration, like a surrogate's losses."""

import csv
import logging
import math
from collections.abc import Mapping
from pathlib import Path
from typing import SupportsFloat

from qdenv.files import write_csv
from qdenv.types import InputError

NOTES = "notes.csv"
PLACE = {"iteration", "evaluations"}  # columns of every note
LOG = logging.getLogger(__name__)
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
            notes = [
                {name: float(value) if value else math.nan for name, value in row.items()}
                for row in csv.DictReader(file, strict=True)
            ]
        if any(not note.keys() >= PLACE for note in notes):
            raise ValueError("a column is missing")
        return notes
    except (OSError, ValueError, TypeError, AttributeError, csv.Error) as error:
        raise InputError(f"{path}: cannot be read ({error})") from error


def notes_until(path: Path, iteration: int) -> list[Note]:
    """Read the notes up to an iteration; damaged ones are lost, which is said and stops no run."""
    try:
        return [note for note in read_notes(path) if note["iteration"] <= iteration]
    except InputError as error:
        LOG.warning("%s: the notes so far are lost", error)
        return []
