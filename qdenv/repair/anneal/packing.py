"""As many obstacles as the rules ask for, whatever layout came in: the last resort near the limit.

Where hardly any layout is left the annealer finds none: it never lets the driving area fall apart,
and the ways to the densest layouts lead through pieces. Straight aisles between two rows of shelves
hold 704 of them at the paper's size; this finds 708, with aisles that end head to head in a seam.

A seam takes few columns and all others are alike. So a narrow layout is packed first, and one of
its columns repeated.
"""

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from qdenv.repair.anneal.packing_moves import Ground, pack_moves
from qdenv.repair.anneal.start import join_bits
from qdenv.repair.anneal.templates import draw_templates
from qdenv.repair.audit import audit
from qdenv.repair.bounds import BESIDE, CROSS
from qdenv.repair.facts import Facts
from qdenv.repair.result import Report, no_report
from qdenv.types import Adjacency

MOVES = 40_000
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
    ground, moves = _lay_out(facts.driving[start], facts, service), MOVES * facts.free_cells
    low, high = facts.count_bounds[0]
    for first in range(0, moves, CHUNK):
        last = min(first + CHUNK, moves)
        if pack_moves(ground, low, high, np.uint64(0), first, last, moves):
            layout = _furnish(ground, facts, service)
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


def _furnish(ground: Ground, facts: Facts, service: Adjacency) -> np.ndarray:
    """Give every cell a tile: beside obstacles those that serve, else the least demanding."""
    allowed, shape = facts.rules.allowed, facts.free.shape
    drives = ground.drives.reshape(shape[0] + 2, -1)[1:-1, 1:-1]
    fits = allowed & (facts.driving == drives[..., None])
    worth = np.where(facts.holding(service.needs), 0.0, 1.0 + facts.demands.max() - facts.demands)
    beside = ndimage.binary_dilation(~drives, BESIDE)[..., None]
    worth = worth + beside * facts.holding(service.needs) * (2.0 + facts.demands.max())
    return (fits * (1.0 + worth)).argmax(-1).astype(np.int8)
