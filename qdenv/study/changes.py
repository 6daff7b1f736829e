"""What a repair changed, by kind of tile."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from qdenv.domains.base import Domain

_SHOWN = 3  # cells of a list that are named, the rest is counted


class Change(NamedTuple):
    """How the cells of one kind of tile changed."""

    tile: str  # its symbol
    name: str  # its name; the symbol where it has none
    # people decide where it stands: no generator draws it, or the rules ask for at least so many of
    # it
    station: bool
    before: int  # how many cells held it
    after: int  # how many do
    removed: list[tuple[int, int]]  # (row, column) of those that hold another tile now
    placed: list[tuple[int, int]]  # (row, column) of those that held another tile


def list_changes(before: np.ndarray, after: np.ndarray, domain: Domain) -> list[Change]:
    """Compare two layouts (int8 [H, W]) of one domain; kinds that stayed are left out."""
    stations = _stations_of(domain)
    changes = []
    for kind, tile in enumerate(domain.tiles):
        held, holds = before == kind, after == kind
        removed, placed = _cells(held & ~holds), _cells(holds & ~held)
        if removed or placed:
            name = domain.names.get(tile, repr(tile))
            counts = int(held.sum()), int(holds.sum())
            changes.append(Change(tile, name, tile in stations, *counts, removed, placed))
    return changes


def describe_changes(changes: Sequence[Change]) -> list[str]:
    """Say what changed, a line per kind of tile under a head."""
    if not changes:
        return ["nothing changed"]
    width = max(len("tile"), *(len(change.name) for change in changes))
    lines = [f"{'tile':{width}}  before  after  cells as (row, column) from 0"]
    lines += [
        f"{change.name:{width}}  {change.before:6}  {change.after:5}  {_say(change)}"
        for change in changes
    ]
    return lines


def warn_of_changes(changes: Sequence[Change]) -> list[str]:
    """Warn of stations that are gone, and of new ones, and say how to prevent it."""
    lines = []
    for change in (change for change in changes if change.station):
        if change.removed:
            lines.append(
                f"WARNING: {len(change.removed)} of the plan's {change.before} {change.name} cells "
                f"changed, the first at row {change.removed[0][0]}, column {change.removed[0][1]}: "
                "--keep FILE keeps the cells that a drawing marks with '!'"
            )
        if change.placed:
            lines.append(
                f"note: {len(change.placed)} {change.name} cells are new, the first at "
                f"row {change.placed[0][0]}, column {change.placed[0][1]}: "
                "--keep FILE keeps them out where a drawing marks the cells with '!'"
            )
    return lines


def _stations_of(domain: Domain) -> set[str]:
    """List the tiles whose place people decide."""
    rules = domain.rules() if domain.rules else None
    at_least = [bound.tiles for bound in rules.counts if bound.high is None] if rules else []
    return (set(domain.tiles) - set(domain.generated)) | set("".join(at_least))


def _cells(mask: np.ndarray) -> list[tuple[int, int]]:
    return [(int(row), int(col)) for row, col in np.argwhere(mask)]


def _say(change: Change) -> str:
    removed, placed = _list_cells(change.removed), _list_cells(change.placed)
    if len(change.removed) == len(change.placed):
        return f"{len(change.removed)} moved: from {removed} to {placed}"
    parts = [f"{len(change.removed)} removed: {removed}"] if removed else []
    parts += [f"{len(change.placed)} placed: {placed}"] if placed else []
    return "; ".join(parts)


def _list_cells(cells: Sequence[tuple[int, int]]) -> str:
    more = f" and {len(cells) - _SHOWN} more" if len(cells) > _SHOWN else ""
    return ", ".join(map(str, cells[:_SHOWN])) + more
