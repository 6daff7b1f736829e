"""As many obstacles as the rules require: regular layouts, and packing them densely.

Regular layouts have two rows of obstacles between aisles. They obey the rules by construction:
every obstacle touches an aisle, so any of them may be left out, and about two thirds of the cells
can be obstacles, which no connected layout exceeds.

Packing is the last resort near that limit. The annealer never lets the driving area fall apart, and
the ways to the densest layouts lead through pieces. Straight aisles hold 704 shelves at the paper's
size; packing finds 708, with aisles that end head to head in a seam. A seam takes few columns and
all others are alike: so a narrow layout is packed first, and one of its columns repeated.
"""

from itertools import product
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from qdenv.grid import MOVES, count_neighbours
from qdenv.native import Scalar, formula, inlined, kernel
from qdenv.progress import Progress, silent
from qdenv.repairs.anneal.connectivity import RING_PIECES
from qdenv.repairs.anneal.start import join_bits
from qdenv.repairs.anneal.state import (
    LEVELS,
    PLACES,
    RISE_LIMITS,
    SIDES,
    random_u64,
    uniform_below,
    uniform_bits,
)
from qdenv.repairs.audit import audit
from qdenv.repairs.rules import Facts
from qdenv.types import Adjacency

_MOVES_PER_CELL = 40_000
_MAX_CELLS = 2500  # that may change: a search for pieces takes longer the more there are
_NARROW = 10  # columns or rows, of those alike, that a narrow layout has
_CHUNK = 2_000_000  # moves between two reports of progress, about a second
_TEMPERATURES = (0.6, 0.08)  # the first and the last, in broken demands
_SWAP = round(0.7 * LEVELS)  # of `LEVELS`: change a second cell near the first one the other way
_REACH = 2  # cells between the two in each direction, at most
_SIDE = 2 * _REACH + 1

# Which bits of a move's first random word decide what: (first bit, number of bits).
_SWAP_BITS = (0, 10)  # two cells with probability SWAP
_NEAR_BITS = (10, 10)  # the second cell, all near the first one equally likely
_CELL_BITS = (32, 32)  # the first cell, all equally likely
_ACCEPT_BITS = (36, 10)  # of its second word: one of the `RISE_LIMITS`


def draw_templates(layout: np.ndarray, facts: Facts) -> list[np.ndarray]:
    """Draw aisles along rows and along columns, in every phase (each int8 [H, W]).

    Obstacles stand where the input `layout` (int8 [H, W]) has some, as far as they fit. Those come
    first that break the fewest rules: fixed cells and odd keep-outs may break one here and there.
    """
    height, width = layout.shape
    aisle, period = facts.aisle, facts.aisle + (facts.depth or 2)
    rows, cols = np.indices((height, width))
    drawn = []
    for along, across, last in ((rows, cols, width), (cols, rows, height)):
        # Aisles across both ends link those along the rows, where no fixed border does.
        spine = (across < aisle) | (across >= last - aisle)
        for link, phase in product((spine, np.zeros_like(spine)), range(period)):
            aisles = ((along + phase) % period < aisle) | link
            drawn.append(_furnish(layout, facts, aisles, (along + phase) // period))
    return sorted(drawn, key=lambda candidate: len(audit(candidate, facts.rules)))


def _furnish(layout: np.ndarray, facts: Facts, aisles: np.ndarray, bands: np.ndarray) -> np.ndarray:
    """Drive everywhere, then put the obstacles that the counts require beside the aisles.

    Racks fill the `bands` (int64 [H, W]) between aisles one by one, each from its end.
    """
    allowed, driving = facts.rules.allowed, facts.driving
    height, width = layout.shape
    # The least demanding driving tile that is allowed, else any allowed tile.
    candidate = (allowed * (1.0 + driving * 100.0 - facts.demands)).argmax(-1).astype(np.int8)
    for bound in facts.rules.counts:
        counted = facts.holding(bound.tiles) & ~driving
        may = (allowed & counted).any(-1) & ~aisles & driving[candidate]
        # Cells first that hold a counted tile in the input.
        order = np.argsort(~counted[layout][may], kind="stable")
        if facts.depth:
            rows, cols = np.nonzero(may)
            along = cols if bands[0, 0] == bands[0, -1] else rows
            order = np.lexsort((along, bands[may]))
        missing = max(bound.low - int(counted[candidate].sum()), 0)
        for row, col in np.argwhere(may)[order[:missing]]:
            own = layout[row, col]
            kind = own if counted[own] else int(np.argmax(allowed[row, col] & counted))
            if allowed[row, col, kind]:
                candidate[row, col] = kind
            # Each of its demands is met by a neighbour, one on an aisle if possible.
            near = [(row + down, col + right) for down, right in MOVES]
            near = [(r, c) for r, c in near if 0 <= r < height and 0 <= c < width]
            for needs in facts.needs[candidate[row, col]]:
                serving = facts.holding(needs)
                if any(serving[candidate[cell]] for cell in near):
                    continue
                for cell in sorted(near, key=lambda cell: not aisles[cell]):
                    fits = serving & driving & allowed[cell]
                    if fits.any() and driving[candidate[cell]]:
                        candidate[cell] = fits.argmax()
                        break
    return candidate


class Packing(NamedTuple):
    """A layout that is being packed; N cells with a ring around it."""

    free: np.ndarray  # int32 [F], the cells that may drive or not
    flips: np.ndarray  # bool [N], the same
    inside: np.ndarray  # bool [N], off the ring
    serves: np.ndarray  # bool [N], whether it may serve the obstacles beside it where it drives
    drives: np.ndarray  # bool [N], where robots drive now
    ring: np.ndarray  # uint8 [N], which of the eight neighbours drive
    steps: np.ndarray  # int64 [9], to these neighbours and to the cell itself
    obstacles: Scalar  # int64 [], the cells where none drives
    unserved: Scalar  # int64 [], obstacles that nothing serves
    pieces: Scalar  # int64 [], unconnected parts of the driving area
    searches: Scalar  # int64 [], for parts, so far
    visited: np.ndarray  # int32 [N], number of the last search that came by
    front: np.ndarray  # int32 [N], buffer of a search


@formula
def _count_unserved(packing: Packing, cell: int) -> int:
    """Count the obstacles on a cell and beside it that none of their neighbours serves."""
    unserved = 0
    for place in (8, 0, 2, 4, 6):
        here = cell + packing.steps[place]
        if packing.inside[here] and not packing.drives[here]:
            alone = True
            for towards in (0, 2, 4, 6):
                side = here + packing.steps[towards]
                alone = alone and not (packing.drives[side] and packing.serves[side])
            unserved += alone
    return unserved


@inlined
def _flip(packing: Packing, cell: int) -> None:
    """Open or close a cell; pieces are `_weigh_pieces`'s."""
    before = _count_unserved(packing, cell)
    packing.drives[cell] = not packing.drives[cell]
    packing.obstacles[()] += -1 if packing.drives[cell] else 1
    packing.unserved[()] += _count_unserved(packing, cell) - before
    for place in range(8):  # a neighbour sees this cell at the opposite place
        packing.ring[cell + packing.steps[place]] ^= 1 << (place + 4 & 7)


@kernel
def _weigh_pieces(packing: Packing, cell: int) -> None:
    """Bring the number of pieces up to date after a cell has opened or closed."""
    # Count the pieces beside the cell, were it closed: opening it joins them in one.
    sides = packing.ring[cell] & SIDES
    pieces, first = 0, packing.searches[()] + 1
    if sides == 0 or RING_PIECES[packing.ring[cell]] == 1:
        pieces, sides = int(sides != 0), 0
    for place in (0, 2, 4, 6):
        root = cell + packing.steps[place]
        if not sides >> place & 1 or packing.visited[root] >= first:
            continue
        pieces += 1
        packing.searches[()] += 1
        packing.visited[root], packing.front[0], size = first, root, 1
        while size:
            size -= 1
            here = packing.front[size]
            for towards in (0, 2, 4, 6):
                there = here + packing.steps[towards]
                if packing.drives[there] and there != cell and packing.visited[there] < first:
                    packing.visited[there], packing.front[size] = first, there
                    size += 1
    packing.pieces[()] += 1 - pieces if packing.drives[cell] else pieces - 1


@formula
def _break_count(packing: Packing, low: int, high: int) -> int:
    """Count the obstacles that are missing, are too many, or are unserved."""
    obstacles, unserved = packing.obstacles[()], packing.unserved[()]
    return max(low - obstacles, 0) + max(obstacles - high, 0) + unserved


@kernel
def pack_moves(
    packing: Packing, low: int, high: int, seed: np.uint64, first: int, last: int, moves: int
) -> bool:
    """Make the moves `first` to `last` - 1 of `moves`; where a run is cut makes no difference.

    Between `low` and `high` obstacles are allowed. Ends where nothing is broken, and returns
    whether that is so.
    """
    hot, cold = _TEMPERATURES
    for index in range(first, last):
        broken, pieces = _break_count(packing, low, high), packing.pieces[()]
        if broken == 0 and pieces <= 1:
            return True
        source = random_u64(seed, 2 * index)
        cell = packing.free[uniform_below(source, _CELL_BITS, packing.free.size)]
        other = cell
        if uniform_bits(source, _SWAP_BITS) < _SWAP:
            step = uniform_below(source, _NEAR_BITS, _SIDE * _SIDE)
            other = cell + (step // _SIDE - _REACH) * packing.steps[4] + step % _SIDE - _REACH
            if not 0 <= other < packing.flips.size or not packing.flips[other]:
                continue
            if packing.drives[other] == packing.drives[cell]:
                continue
        temperature = hot * (cold / hot) ** (index / moves)
        source = random_u64(seed, 2 * index + 1)
        limit = temperature * RISE_LIMITS[uniform_bits(source, _ACCEPT_BITS)]
        limit += broken + pieces
        _flip(packing, cell)
        if other != cell:
            _flip(packing, other)
        # The most expensive test comes last; pieces are weighed after one change, then after both.
        accept = _break_count(packing, low, high) <= limit - max(pieces - 1, 0)
        if accept:
            if other != cell:
                _flip(packing, other)
            _weigh_pieces(packing, cell)
            if other != cell:
                _flip(packing, other)
                _weigh_pieces(packing, other)
            accept = _break_count(packing, low, high) + packing.pieces[()] <= limit
        if not accept:
            _flip(packing, cell)
            if other != cell:
                _flip(packing, other)
            packing.pieces[()] = pieces
    return _break_count(packing, low, high) == 0 and packing.pieces[()] <= 1


def pack(facts: Facts, progress: Progress = silent) -> np.ndarray | None:
    """Find a layout (int8 [H, W]) that obeys the rules, however many obstacles they require.

    Only for rules with one count, of obstacles, all of which driving cells have to serve. None
    proves nothing.
    """
    rules = facts.rules
    obstacles = set(rules.tiles) - set(rules.connected)
    demands = [rule for rule in rules.adjacency if set(rule.tiles) & obstacles]
    if not rules.connected or rules.covers or len(rules.counts) != 1 or len(demands) != 1:
        return None
    (service,), (count,) = demands, rules.counts
    if service not in facts.services or not set(service.tiles) == obstacles == set(count.tiles):
        return None
    if not 0 < facts.free_cells <= _MAX_CELLS:
        return None
    for axis in (1, 0):
        layout = _pack_narrow(facts, axis, service, progress)
        if layout is not None:
            return layout
    return _pack_whole(facts, service, progress)


def _pack_narrow(
    facts: Facts, axis: int, service: Adjacency, progress: Progress
) -> np.ndarray | None:
    """Pack with columns (axis 1) or rows (0) left out, then repeat one of the others; None if none.

    They are left out of the longest stretch of those that may hold the same, behind `_NARROW`
    others, and with them the obstacles that straight aisles have there.
    """
    rules = facts.rules
    lines = np.moveaxis(rules.allowed, axis, 0)
    ends = np.array([0, *(np.flatnonzero((lines[1:] != lines[:-1]).any((1, 2))) + 1), len(lines)])
    longest = int(np.diff(ends).argmax())
    first, last = int(ends[longest]) + _NARROW, int(ends[longest + 1])
    if first >= last:
        return None
    straight = max(
        int(np.moveaxis(~facts.driving[start], axis, 0)[first:last].sum(1).min())
        for start in draw_templates(facts.any_layout, facts)
    )
    (count,), less = rules.counts, (last - first) * straight
    high = None if count.high is None else max(count.high - less, 0)
    narrow_rules = rules._replace(
        counts=(count._replace(low=max(count.low - less, 0), high=high),),
        allowed=np.delete(rules.allowed, np.s_[first:last], axis),
        change_cost=np.delete(rules.change_cost, np.s_[first:last], axis),
    )
    narrow = _pack_whole(Facts(narrow_rules), service, progress)
    if narrow is None:
        return None
    for line in range(first - _NARROW, first):
        times = np.ones(narrow.shape[axis], np.int64)
        times[line] += last - first
        layout = np.repeat(narrow, times, axis)
        if not audit(layout, rules):
            return layout
    return None


def _pack_whole(facts: Facts, service: Adjacency, progress: Progress) -> np.ndarray | None:
    """Pack all cells at once."""
    start = draw_templates(facts.any_layout, facts)[0]
    packing = start_packing(facts.driving[start], facts, service)
    moves = _MOVES_PER_CELL * facts.free_cells
    low, high = facts.count_bounds[0]
    for first in range(0, moves, _CHUNK):
        last = min(first + _CHUNK, moves)
        if pack_moves(packing, low, high, np.uint64(0), first, last, moves):
            break
        progress("packing", last / moves, "")
    else:
        return None
    # Give every cell a tile: beside obstacles those that serve, else the least demanding.
    drives = packing.drives.reshape(start.shape[0] + 2, -1)[1:-1, 1:-1]
    fits = facts.rules.allowed & (facts.driving == drives[..., None])
    serving, most = facts.holding(service.needs), facts.demands.max()
    worth = np.where(serving, 0.0, 1.0 + most - facts.demands)
    beside = (count_neighbours(~drives) > 0)[..., None]
    worth = worth + beside * serving * (2.0 + most)
    layout = (fits * (1.0 + worth)).argmax(-1).astype(np.int8)
    return None if audit(layout, facts.rules) else layout


def start_packing(driving: np.ndarray, facts: Facts, service: Adjacency) -> Packing:
    """Prepare to pack from where robots drive (bool [H, W])."""
    steps, connected = PLACES @ (driving.shape[1] + 2, 1), facts.rules.connected
    flips = np.pad(facts.may(connected) & ~facts.must(connected), 1).ravel()
    drives = np.pad(driving, 1).ravel()
    unserved = ~driving & (count_neighbours(driving & facts.may(service.needs)) == 0)
    return Packing(
        free=np.flatnonzero(flips).astype(np.int32),
        flips=flips,
        inside=np.pad(np.ones(driving.shape, bool), 1).ravel(),
        serves=np.pad(facts.may(service.needs), 1).ravel(),
        drives=drives,
        ring=join_bits(drives, steps),
        steps=np.append(steps, 0),
        obstacles=np.array((~driving).sum(), np.int64),
        unserved=np.array(unserved.sum(), np.int64),
        pieces=np.array(ndimage.label(driving)[1], np.int64),
        searches=np.array(0, np.int64),
        visited=np.zeros(flips.size, np.int32),
        front=np.zeros(flips.size, np.int32),
    )
