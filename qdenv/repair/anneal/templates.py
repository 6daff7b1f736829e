"""Regular layouts that obey the rules by construction: where annealing starts as a last resort.

Aisles with two rows of obstacles between them: every obstacle touches an aisle, so any of them may
be left out, and about two thirds of the cells can be obstacles, which no connected layout exceeds.
"""

import numpy as np

from qdenv.grid import MOVES
from qdenv.repair.facts import Facts


def draw_templates(layout: np.ndarray, facts: Facts) -> list[np.ndarray]:
    """Draw aisles along rows and along columns, in every phase (each int8 [H, W]).

    Args:
        layout: int8 [H, W], the input: obstacles stand where it has some, as far as they fit.
        facts: the constraints.

    Returns:
        Candidates; fixed cells and odd keep-outs may still break a rule here and there.
    """
    height, width = layout.shape
    aisle, period = facts.rules.aisle, facts.rules.aisle + 2
    rows, cols = np.indices((height, width))
    drawn = []
    for along, across, last in ((rows, cols, width), (cols, rows, height)):
        # Aisles across both ends link those along the rows, where no fixed border does.
        spine = (across < aisle) | (across >= last - aisle)
        for link in (spine, np.zeros_like(spine)):
            drawn += [
                _furnish(layout, facts, ((along + phase) % period < aisle) | link)
                for phase in range(period)
            ]
    return drawn


def _furnish(layout: np.ndarray, facts: Facts, aisles: np.ndarray) -> np.ndarray:
    """Drive everywhere, then put the obstacles that the counts ask for beside the aisles."""
    allowed = facts.rules.allowed
    # The least demanding driving tile that is allowed, else any allowed tile.
    candidate = (allowed * (1.0 + facts.driving * 100.0 - facts.demands)).argmax(-1).astype(np.int8)
    for bound in facts.rules.counts:
        wanted = facts.holding(bound.tiles) & ~facts.driving
        may = (allowed & wanted).any(-1) & ~aisles & facts.driving[candidate]
        missing = bound.low - int(wanted[candidate].sum())
        for row, col in _alike_first(may, wanted[layout]):
            if missing <= 0:
                break
            own = layout[row, col]
            kind = own if wanted[own] else int(np.argmax(allowed[row, col] & wanted))
            candidate[row, col] = kind if allowed[row, col, kind] else candidate[row, col]
            _serve(candidate, facts, row, col, aisles)
            missing -= 1
    return candidate


def _alike_first(may: np.ndarray, alike: np.ndarray) -> np.ndarray:
    """List the cells of `may` (bool [H, W]), those of `alike` first (int64 [cells, 2])."""
    cells = np.argwhere(may)
    return cells[np.argsort(~alike[may], kind="stable")]


def _serve(candidate: np.ndarray, facts: Facts, row: int, col: int, aisles: np.ndarray) -> None:
    """Give the tile at a cell the neighbour on an aisle that each of its demands asks for."""
    height, width = candidate.shape
    beside = [(row + down, col + right) for down, right in MOVES]
    beside = [(r, c) for r, c in beside if 0 <= r < height and 0 <= c < width]
    for needs in facts.needs[candidate[row, col]]:
        serving = facts.holding(needs)
        if any(serving[candidate[cell]] for cell in beside):
            continue
        for cell in sorted(beside, key=lambda cell: not aisles[cell]):
            fits = serving & facts.driving & facts.rules.allowed[cell]
            if fits.any() and facts.driving[candidate[cell]]:
                candidate[cell] = fits.argmax()
                break
