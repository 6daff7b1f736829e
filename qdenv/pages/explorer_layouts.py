"""Layouts and their growth as the explorer holds them: a few bits a tile, in chunks."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from qdenv.pages.page import pack
from qdenv.progress import Progress
from qdenv.run.archive import Archive
from qdenv.study.elites import Grower, spread

LAYOUTS = 256  # elites in a chunk of layouts
GROWN = 16  # elites in a chunk of growth
AT_ONCE = 64  # elites grown by one call
ROOM = 12_000_000  # bytes that growth may take in a file unless more is asked for


class Growth(NamedTuple):
    """How elites grow."""

    steps: int  # of growth; 0 where nothing grows
    rows: list[int]  # of the archive's elites whose growth is here, in the order of the chunks
    # cells in which an elite that grew here differs from what the run drew, by row; those of no
    # difference are left out
    differing: dict[int, int]
    packed: dict[str, str]  # chunks by name


def bits_of(tiles: str) -> int:
    """Say how many bits hold a tile of an alphabet: 1, 2, 4 or 8."""
    return next(bits for bits in (1, 2, 4, 8) if len(tiles) <= 2**bits)


def pack_bits(tiles: np.ndarray, bits: int) -> np.ndarray:
    """Put several tiles into a byte, the first into the lowest bits.

    Args:
        tiles: uint8 [n, cells].
        bits: of a tile.

    Returns:
        uint8 [n, bytes]; the last byte of a row is filled up with zeros.
    """
    each = 8 // bits
    padded = np.pad(tiles, ((0, 0), (0, -tiles.shape[1] % each)))
    parts = (padded[:, part::each] << (bits * part) for part in range(each))
    return sum(parts, np.zeros((len(tiles), padded.shape[1] // each), np.uint8))


def pack_layouts(archive: Archive, bits: int) -> dict[str, str]:
    """Pack all layouts, and in which tiles they differ from what was drawn before the repair."""
    kinds, cells = len(archive.meaning.tiles), archive.columns["repaired"][0].size
    repaired = archive.columns["repaired"].reshape(-1, cells)
    drawn = archive.columns.get("unrepaired", archive.columns["repaired"]).reshape(-1, cells)
    change = (drawn - repaired) % kinds
    packed = {}
    for number, start in enumerate(range(0, len(archive), LAYOUTS)):
        part = slice(start, start + LAYOUTS)
        both = [pack_bits(one[part].astype(np.uint8), bits) for one in (repaired, change)]
        packed[f"layouts-{number}"] = pack(np.stack(both))
    return packed


def grow_elites(
    archive: Archive, steps: int, grow: Grower, wanted: int | None, progress: Progress
) -> Growth:
    """Grow elites again, evenly spread over the archive, the best first.

    Args:
        archive: of a run.
        steps: of growth.
        grow: their generator, as `make_grower` makes it.
        wanted: how many; None for as many as the usual room holds.
        progress: told how far it is.
    """
    growth = Growth(steps, [], {}, {})
    if not steps or wanted == 0:
        return growth
    best = int(np.flatnonzero((archive.cells == archive.best.cell).all(axis=1))[0])
    rows, size = spread(archive.cells, best), 0
    while size < ROOM or wanted is not None:
        left = AT_ONCE if wanted is None else min(AT_ONCE, wanted - len(growth.rows))
        batch = list(itertools.islice(rows, left))
        if not batch:
            break
        size += _add(growth, archive, batch, grow(_filled(archive.columns["solution"][batch])))
        done = len(growth.rows) / min(len(archive), wanted or len(archive))
        progress("growing", max(done, size / ROOM if wanted is None else 0), "")
    return growth


def _filled(solutions: np.ndarray) -> np.ndarray:
    """Fill a batch up to the size that is compiled."""
    return np.pad(solutions, ((0, AT_ONCE - len(solutions)), (0, 0)))


def _add(growth: Growth, archive: Archive, batch: list[int], frames: np.ndarray) -> int:
    """Add a batch and say how many bytes it takes."""
    bits, size = bits_of(archive.meaning.tiles), 0
    for row, layouts in zip(batch, frames, strict=False):
        drawn = archive.columns.get("unrepaired")
        differing = 0 if drawn is None else int((layouts[-1] != drawn[row]).sum())
        if differing:
            growth.differing[row] = differing
    for start in range(0, len(batch), GROWN):
        part = frames[start : min(start + GROWN, len(batch))].astype(np.uint8)
        name = f"growth-{len(growth.packed)}"
        growth.packed[name] = pack(pack_bits(part.reshape(len(part), -1), bits))
        size += len(growth.packed[name])
    growth.rows.extend(batch)
    return size
