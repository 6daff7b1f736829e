"""Regular layouts that obey the rules by construction: where annealing starts as a last resort.

Aisles with two rows of obstacles between them: every obstacle touches an aisle, so any of them may
be left out, and about two thirds of the cells can be obstacles, which no connected layout exceeds.
"""

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from qdenv.grid import MOVES
from qdenv.native import formula, inlined, kernel
from qdenv.repair.anneal.connectivity import RING_PIECES, SIDES
from qdenv.repair.anneal.start import join_bits
from qdenv.repair.anneal.state import LEVELS, LIMITS, below, bits, word
from qdenv.repair.audit import audit
from qdenv.repair.rules import BESIDE, CROSS, Facts, Report, no_report
from qdenv.types import Adjacency


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


TEMPERATURES = (0.6, 0.08)  # the first and the last, in broken demands
SWAP = round(0.7 * LEVELS)  # of `LEVELS`: change a second cell near the first one the other way
REACH = 2  # cells away in each direction
_WORDS = 2  # random words that one move uses
_SIDE = 2 * REACH + 1


class Ground(NamedTuple):
    """What is being packed; N cells with a ring around the layout."""

    free: np.ndarray  # int32 [F], the cells that may drive or not
    flips: np.ndarray  # bool [N], the same
    inside: np.ndarray  # bool [N], off the ring
    serves: np.ndarray  # bool [N], whether it may serve the obstacles beside it where it drives
    drives: np.ndarray  # bool [N], where robots drive now
    ring: np.ndarray  # uint8 [N], which of the eight neighbours drive
    steps: np.ndarray  # int64 [8], to these neighbours
    seen: np.ndarray  # int32 [N], number of the last search that came by
    front: np.ndarray  # int32 [N], room for a search
    tolls: np.ndarray  # int64 [4]: obstacles, unserved ones, pieces, searches so far


@formula
def _is_unserved(ground: Ground, cell: int) -> int:
    """Whether an obstacle stands on a cell and none of its neighbours serves it."""
    alone = ground.inside[cell] and not ground.drives[cell]
    for place in (0, 2, 4, 6):
        side = cell + ground.steps[place]
        alone = alone and not (ground.drives[side] and ground.serves[side])
    return int(alone)


@inlined
def _flip(ground: Ground, cell: int) -> None:
    """Open or close a cell; pieces are `_weigh_pieces`'s."""
    steps, unserved = ground.steps, -_is_unserved(ground, cell)
    for place in (0, 2, 4, 6):
        side = cell + steps[place]
        if ground.inside[side]:
            unserved -= _is_unserved(ground, side)
    ground.drives[cell] = not ground.drives[cell]
    ground.tolls[0] += -1 if ground.drives[cell] else 1
    unserved += _is_unserved(ground, cell)
    for place in (0, 2, 4, 6):
        side = cell + steps[place]
        if ground.inside[side]:
            unserved += _is_unserved(ground, side)
    ground.tolls[1] += unserved
    for place in range(8):
        ground.ring[cell + steps[place]] ^= 1 << (place + 4 & 7)


@kernel
def _count_around(ground: Ground, cell: int) -> int:
    """Count the pieces beside a cell, were it closed."""
    sides = ground.ring[cell] & SIDES
    if sides == 0 or RING_PIECES[ground.ring[cell]] == 1:
        return int(sides != 0)
    pieces, first = 0, ground.tolls[3] + 1
    for place in (0, 2, 4, 6):
        root = cell + ground.steps[place]
        if not sides >> place & 1 or ground.seen[root] >= first:
            continue
        pieces += 1
        ground.tolls[3] += 1
        ground.seen[root], ground.front[0], size = first, root, 1
        while size:
            size -= 1
            here = ground.front[size]
            for towards in (0, 2, 4, 6):
                there = here + ground.steps[towards]
                if ground.drives[there] and there != cell and ground.seen[there] < first:
                    ground.seen[there], ground.front[size] = first, there
                    size += 1
    return pieces


@inlined
def _weigh_pieces(ground: Ground, cell: int) -> None:
    """Bring the number of pieces up to date after a cell has opened or closed."""
    change = _count_around(ground, cell) - 1
    ground.tolls[2] += -change if ground.drives[cell] else change


@formula
def _break_count(ground: Ground, low: int, high: int) -> int:
    """Count the obstacles that are missing, are too many, or are unserved."""
    obstacles, unserved = ground.tolls[0], ground.tolls[1]
    return max(low - obstacles, 0) + max(obstacles - high, 0) + unserved


@formula
def _draw_partner(ground: Ground, cell: int, source: np.uint64) -> int:
    """Draw a cell near another, which may be off the ground."""
    step = below(source, 10, 10, _SIDE * _SIDE)
    return cell + (step // _SIDE - REACH) * ground.steps[4] + step % _SIDE - REACH


@inlined
def _try_flips(ground: Ground, cell: int, other: int, limit: float, low: int, high: int) -> None:
    """Change a cell, and another unless that is the same, if the energy stays within a limit."""
    pieces = ground.tolls[2]
    _flip(ground, cell)
    if other != cell:
        _flip(ground, other)
    # The dearest test comes last; pieces are weighed after one change, then after both.
    accept = _break_count(ground, low, high) <= limit - max(pieces - 1, 0)
    if accept:
        if other != cell:
            _flip(ground, other)
        _weigh_pieces(ground, cell)
        if other != cell:
            _flip(ground, other)
            _weigh_pieces(ground, other)
        accept = _break_count(ground, low, high) + ground.tolls[2] <= limit
    if not accept:
        _flip(ground, cell)
        if other != cell:
            _flip(ground, other)
        ground.tolls[2] = pieces


@kernel
def pack_moves(
    ground: Ground, low: int, high: int, seed: np.uint64, first: int, last: int, moves: int
) -> bool:
    """Make the moves `first` to `last` - 1; where a run is cut makes no difference.

    Args:
        ground: where to start; ends where the last move led.
        low: obstacles, at least.
        high: obstacles, at most.
        seed: of all draws.
        first: number of the first move.
        last: number of the one after the last.
        moves: of the whole run, during which the temperature falls geometrically.

    Returns:
        Whether nothing is broken; the run ends there.
    """
    hot, cold = TEMPERATURES
    for index in range(first, last):
        if _break_count(ground, low, high) == 0 and ground.tolls[2] <= 1:
            return True
        source = word(seed, _WORDS * index)
        cell = ground.free[below(source, 32, 32, ground.free.size)]
        other = cell
        if bits(source, 0, 10) < SWAP:
            other = _draw_partner(ground, cell, source)
            if not 0 <= other < ground.flips.size or not ground.flips[other]:
                continue
            if ground.drives[other] == ground.drives[cell]:
                continue
        temperature = hot * (cold / hot) ** (index / moves)
        limit = temperature * LIMITS[bits(word(seed, _WORDS * index + 1), 36, 10)]
        limit += _break_count(ground, low, high) + ground.tolls[2]
        _try_flips(ground, cell, other, limit, low, high)
    return _break_count(ground, low, high) == 0 and ground.tolls[2] <= 1


MOVES_PER_CELL = 40_000
MAX_CELLS = 2500  # that may change: a search for pieces takes longer the more there are
NARROW = 10
CHUNK = 2_000_000  # moves between two reports, about a second


class _Lines(NamedTuple):
    """Columns or rows of a layout that may hold the same, one beside the other."""

    axis: int  # 1 for columns, 0 for rows
    first: int  # the first of those left out of the narrow layout, behind `NARROW` others
    left_out: int  # how many are
    obstacles: int  # in each of them, where aisles are straight


def pack(facts: Facts, report: Report = no_report) -> np.ndarray | None:
    """Find a layout that obeys the rules, however many obstacles they ask for.

    Only for rules with one count, of obstacles, all of which driving cells have to serve.

    Args:
        facts: the constraints.
        report: told now and then which share of the moves is done.

    Returns:
        A layout (int8 [H, W]), or None where none was found, which proves nothing.
    """
    service = _find_service(facts)
    if service is None or not 0 < facts.free_cells <= MAX_CELLS:
        return None
    for axis in (1, 0):
        lines = _find_lines(facts, axis)
        if lines is not None:
            narrow = _pack_whole(_narrowed(facts, lines), service, report)
            widened = None if narrow is None else _widened(narrow, lines, facts)
            if widened is not None:
                return widened
    return _pack_whole(facts, service, report)


def _draw_starts(facts: Facts) -> list[np.ndarray]:
    """Draw regular layouts (each int8 [H, W]), those first that break the fewest rules."""
    any_layout = facts.rules.allowed.argmax(-1).astype(np.int8)
    starts = draw_templates(any_layout, facts)
    return sorted(starts, key=lambda layout: len(audit(layout, facts.rules)))


def _pack_whole(facts: Facts, service: Adjacency, report: Report) -> np.ndarray | None:
    """Pack all cells at once."""
    start = _draw_starts(facts)[0]
    ground, moves = (
        _lay_out(facts.driving[start], facts, service),
        MOVES_PER_CELL * facts.free_cells,
    )
    low, high = facts.count_bounds[0]
    for first in range(0, moves, CHUNK):
        last = min(first + CHUNK, moves)
        if pack_moves(ground, low, high, np.uint64(0), first, last, moves):
            layout = _choose_tiles(ground, facts, service)
            return None if audit(layout, facts.rules) else layout
        report("packing", last / moves)
    return None


def _find_lines(facts: Facts, axis: int) -> _Lines | None:
    """Find the longest stretch of columns (axis 1) or rows (0) of which some can be left out."""
    allowed = np.moveaxis(facts.rules.allowed, axis, 0)
    changes = np.flatnonzero((allowed[1:] != allowed[:-1]).any((1, 2))) + 1
    ends = np.array([0, *changes, len(allowed)])
    longest = int(np.diff(ends).argmax())
    first, last = int(ends[longest]) + NARROW, int(ends[longest + 1])
    if first >= last:
        return None
    stands = [np.moveaxis(~facts.driving[start], axis, 0) for start in _draw_starts(facts)]
    straight = max(int(obstacles[first:last].sum(1).min()) for obstacles in stands)
    return _Lines(axis, first, last - first, straight)


def _narrowed(facts: Facts, lines: _Lines) -> Facts:
    """Leave columns or rows out, and the obstacles that straight aisles have there."""
    rules, gone = facts.rules, np.s_[lines.first : lines.first + lines.left_out]
    (count,), less = rules.counts, lines.left_out * lines.obstacles
    high = None if count.high is None else max(count.high - less, 0)
    counts = (count._replace(low=max(count.low - less, 0), high=high),)
    allowed = np.delete(rules.allowed, gone, lines.axis)
    change_cost = np.delete(rules.change_cost, gone, lines.axis)
    return Facts(rules._replace(counts=counts, allowed=allowed, change_cost=change_cost))


def _widened(narrow: np.ndarray, lines: _Lines, facts: Facts) -> np.ndarray | None:
    """Repeat one column or row of a narrow layout so that every rule still holds; None if none."""
    for line in range(lines.first - NARROW, lines.first):
        times = np.ones(narrow.shape[lines.axis], int)
        times[line] += lines.left_out
        layout = np.repeat(narrow, times, lines.axis)
        if not audit(layout, facts.rules):
            return layout
    return None


def _find_service(facts: Facts) -> Adjacency | None:
    """Find the rule by which driving cells serve all obstacles, which are all that is counted."""
    rules = facts.rules
    obstacles = set(rules.tiles) - set(rules.connected)
    demands = [rule for rule in rules.adjacency if set(rule.tiles) & obstacles]
    if not rules.connected or rules.aisle > 1 or len(rules.counts) != 1 or len(demands) != 1:
        return None
    (service,), (count,) = demands, rules.counts
    apart = set(service.needs) <= set(rules.connected)
    return service if apart and set(service.tiles) == obstacles == set(count.tiles) else None


def _lay_out(driving: np.ndarray, facts: Facts, service: Adjacency) -> Ground:
    """Prepare to pack from where robots drive (bool [H, W])."""
    stride, connected = driving.shape[1] + 2, facts.rules.connected
    steps = np.array([-stride, 1 - stride, 1, stride + 1, stride, stride - 1, -1, -stride - 1])
    flips = np.pad(facts.may(connected) & ~facts.must(connected), 1).ravel()
    serves, drives = np.pad(facts.may(service.needs), 1).ravel(), np.pad(driving, 1)
    unserved = ~driving & ~ndimage.binary_dilation(driving & facts.may(service.needs), BESIDE)
    tolls = [(~driving).sum(), unserved.sum(), ndimage.label(driving, CROSS)[1], 0]
    return Ground(
        free=np.flatnonzero(flips).astype(np.int32),
        flips=flips,
        inside=np.pad(np.ones(driving.shape, bool), 1).ravel(),
        serves=serves,
        drives=drives.ravel(),
        ring=join_bits(drives.ravel(), steps),
        steps=steps,
        seen=np.zeros(flips.size, np.int32),
        front=np.zeros(flips.size, np.int32),
        tolls=np.array(tolls, np.int64),
    )


def _choose_tiles(ground: Ground, facts: Facts, service: Adjacency) -> np.ndarray:
    """Give every cell a tile: beside obstacles those that serve, else the least demanding."""
    allowed, shape = facts.rules.allowed, facts.free.shape
    drives = ground.drives.reshape(shape[0] + 2, -1)[1:-1, 1:-1]
    fits = allowed & (facts.driving == drives[..., None])
    worth = np.where(facts.holding(service.needs), 0.0, 1.0 + facts.demands.max() - facts.demands)
    beside = ndimage.binary_dilation(~drives, BESIDE)[..., None]
    worth = worth + beside * facts.holding(service.needs) * (2.0 + facts.demands.max())
    return (fits * (1.0 + worth)).argmax(-1).astype(np.int8)
