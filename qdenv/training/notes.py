"""notes.csv: what an algorithm says of itself after each iteration, like a surrogate's losses."""

import logging
import math
from collections.abc import Mapping
from pathlib import Path
from typing import SupportsFloat

from qdenv.io.files import damaged, write_csv
from qdenv.io.tables import parse_cell, read_rows
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
    notes = []
    for number, row in enumerate(read_rows(path), start=1):
        if not row.keys() >= PLACE:
            raise damaged(path, f"one of the columns {', '.join(sorted(PLACE))} is missing")
        try:
            notes.append({name: _number(text) for name, text in row.items()})
        except ValueError as error:
            raise damaged(path, f"row {number}: {error}") from error
    return notes


def _number(text: str) -> float:
    return parse_cell(text, float, infinite=True) if text else math.nan


def notes_until(path: Path, iteration: int) -> list[Note]:
    """Read the notes up to an iteration; damaged ones are lost, which is said and stops no run."""
    try:
        return [note for note in read_notes(path) if note["iteration"] <= iteration]
    except InputError as error:
        LOG.warning("%s: the notes so far are lost", error)
        return []
