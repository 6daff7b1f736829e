"""Rows that hold for every layout whose driving area is one piece: they make its relaxation tight.

One piece of n cells has a spanning tree of n - 1 edges. A side of a driving cell is an edge of the
tree or serves one obstacle, so a part of c cells serves 2 c + 1 obstacles at most: what `bounds`
counts for a whole layout, here the solver may state of any part of it. Cells that always drive and
hang together count as one.
"""

import threading
from collections import OrderedDict
from typing import NamedTuple

import highspy
import numpy as np
from scipy import ndimage, sparse

from qdenv.repair.anneal.packing import pack
from qdenv.repair.audit import audit
from qdenv.repair.milp.highs import (
    CROSS,
    add_cuts,
    load,
    mend,
    read_layout,
    read_values,
    separate,
    solve_relaxation,
)
from qdenv.repair.milp.program import Affine, Program, build
from qdenv.repair.rules import Facts, Report, no_report
from qdenv.types import Adjacency, RepairStatus, Rules


class _Sides(NamedTuple):
    """Directed pairs of neighbouring cells, two for each pair: ``n`` of them."""

    start: np.ndarray  # int64 [n], position of a cell
    # int64 [n], of its neighbour; the second half of the pairs is the first reversed
    end: np.ndarray


def span(program: Program, facts: Facts) -> Program:
    """Add a spanning tree and who serves whom to a program: the same layouts, a tighter relaxation.

    Args:
        program: from `program.build`; its rows keep their place and so do its variables.
        facts: the constraints.

    Returns:
        The program with more rows, and more (continuous) variables behind the others.
    """
    if not facts.rules.connected:
        return program
    sides = _list_sides(facts)
    count, total = sides.start.size // 2, program.variables.total
    serving = [rule for rule in facts.rules.adjacency if _is_service(rule, facts)]
    driving = program.variables.group(facts, facts.rules.connected)
    edge = sparse.vstack([sparse.eye_array(count)] * 2)
    # An edge of the tree needs both its cells to drive.
    blocks = [_wide(driving.at(sides.start), -edge, 0, total, count, len(serving))]
    blocks.append(_count_edges(driving, facts, sides, len(serving)))
    blocks += _break_rings(driving, facts, sides, len(serving))
    for place, rule in enumerate(serving):
        blocks += _serve(program, facts, sides, rule, place, len(serving))
    rows = sparse.csr_array(sparse.vstack([block.matrix for block in blocks]))
    low = -np.concatenate([block.offset for block in blocks])  # no expression is negative
    more = rows.shape[1] - total
    old = sparse.hstack([program.rows, sparse.csr_array((program.low.size, more))])
    return program._replace(
        cost=np.pad(program.cost, (0, more)),
        upper=np.pad(program.upper, (0, more), constant_values=1.0),
        integer=np.pad(program.integer, (0, more)),
        rows=sparse.csr_array(sparse.vstack([old, rows])),
        low=np.concatenate([program.low, low]),
        high=np.concatenate([program.high, np.full(low.size, np.inf)]),
    )


def _list_sides(facts: Facts) -> _Sides:
    """List the sides between cells, without those within what always drives."""
    cells = np.arange(facts.free.size).reshape(facts.free.shape)
    pairs = [(cells[:, :-1], cells[:, 1:]), (cells[:-1], cells[1:])]
    one, other = (np.concatenate([pair[side].ravel() for pair in pairs]) for side in range(2))
    always = facts.must(facts.rules.connected).ravel()
    counts = ~(always[one] & always[other])
    one, other = one[counts], other[counts]
    return _Sides(np.concatenate([one, other]), np.concatenate([other, one]))


def _is_service(rule: Adjacency, facts: Facts) -> bool:
    """Tell whether by this rule driving cells serve obstacles."""
    connected = set(facts.rules.connected)
    return not set(rule.tiles) & connected and set(rule.needs) <= connected


def _wide(
    cells: Affine, extra: sparse.sparray, first: int, total: int, count: int, rules: int
) -> Affine:
    """Put columns of new variables, from number `first` on, behind those of an expression."""
    left = sparse.csr_array((extra.shape[0], first))
    right = sparse.csr_array((extra.shape[0], count * (1 + 2 * rules) - first - extra.shape[1]))
    assert cells.matrix.shape[1] == total
    return Affine(sparse.csr_array(sparse.hstack([cells.matrix, left, extra, right])), cells.offset)


def _count_edges(driving: Affine, facts: Facts, sides: _Sides, rules: int) -> Affine:
    """The tree has an edge less than the driving area has cells, fixed parts counted as one."""
    always = facts.must(facts.rules.connected)
    _, parts = ndimage.label(always, CROSS)
    count, total = sides.start.size // 2, driving.matrix.shape[1]
    cells = driving.combined(-(~always.ravel()).astype(float))
    edges = sparse.csr_array(np.ones((1, count)))
    return _less(_wide(cells, edges, 0, total, count, rules), parts - 1.0)


def _break_rings(driving: Affine, facts: Facts, sides: _Sides, rules: int) -> list[Affine]:
    """Within a square of four cells a tree has an edge less than cells that drive."""
    height, width = facts.free.shape
    count, total = sides.start.size // 2, driving.matrix.shape[1]
    parts, _ = ndimage.label(facts.must(facts.rules.connected), CROSS)
    corner = np.arange(facts.free.size).reshape(height, width)[:-1, :-1].ravel()
    squares = corner[:, None] + np.array([0, 1, width, width + 1])
    rows = np.arange(corner.size)
    inside = sparse.csr_array(
        (np.ones(squares.size), (np.repeat(rows, 4), squares.ravel())),
        shape=(corner.size, facts.free.size),
    )
    one, other = (inside[:, ends[:count]] for ends in (sides.start, sides.end))
    edges = sparse.csr_array(one.multiply(other))
    held = parts.ravel()[squares]
    fixed = np.array([np.unique(row[row > 0]).size for row in held])
    free = driving.combined(inside @ sparse.diags_array((parts.ravel() == 0).astype(float)))
    whole = _wide(free, -edges, 0, total, count, rules)
    # What always drives counts as one cell, which is the one less.
    found = [_less(whole.at(rows[fixed > 0]), 1.0 - fixed[fixed > 0])]
    for place in range(4):
        less = driving.at(squares[:, place])
        none = sparse.csr_array((corner.size, count))
        short = whole.minus(_wide(less, none, 0, total, count, rules))
        found.append(short.at(rows[fixed == 0]))
    return found


def _serve(
    program: Program, facts: Facts, sides: _Sides, rule: Adjacency, place: int, rules: int
) -> list[Affine]:
    """Every obstacle is served over a side, which is no edge of the tree then."""
    count, total = sides.start.size // 2, program.variables.total
    first, variables = count * (1 + 2 * place), program.variables
    each = sparse.eye_array(2 * count, format="csr")
    edge = sparse.vstack([sparse.eye_array(count)] * 2)
    driving = variables.group(facts, facts.rules.connected).at(sides.start)
    server = variables.group(facts, rule.needs).at(sides.start)
    obstacle = variables.group(facts, rule.tiles)
    used = _wide(driving, -edge, 0, total, count, rules)
    used = used.plus(_wide(_nothing(driving), -each, first, total, count, rules))
    may = np.flatnonzero(facts.may(rule.tiles).ravel())
    ends = sparse.csr_array(
        (np.ones(2 * count), (sides.end, np.arange(2 * count))),
        shape=(facts.free.size, 2 * count),
    )
    served = _wide(_nothing(obstacle).minus(obstacle), ends, first, total, count, rules)
    return [
        _wide(server, -each, first, total, count, rules),
        _wide(obstacle.at(sides.end), -each, first, total, count, rules),
        used,
        served.at(may),
    ]


def _less(cells: Affine, numbers: float | np.ndarray) -> Affine:
    """Take numbers off expressions."""
    return cells._replace(offset=cells.offset - numbers)


def _nothing(like: Affine) -> Affine:
    """Give as many expressions that are zero."""
    return Affine(like.matrix * 0, like.offset * 0)


MAX_CELLS = 20_000  # that may change: beyond, the relaxation alone takes minutes
BRANCHED_CELLS = 120  # that may change: with more, branching decides little
NODES = 2000  # of one solve
ASKED = 2000  # times one solve may ask whether to go on
ROUNDS = 40  # solves, each with more connectivity cuts
REMEMBERED = 32  # rules whose answer is kept


class Possible(NamedTuple):
    """What is known of some rules."""

    # `ANNEALED` where a layout is known, `IMPOSSIBLE` where none exists, else `FAILED`
    status: RepairStatus
    layout: np.ndarray | None = None  # int8 [H, W], obeys every rule; None where none is known


IMPOSSIBLE, UNKNOWN = Possible(RepairStatus.IMPOSSIBLE), Possible(RepairStatus.FAILED)

_answers: OrderedDict[bytes, Possible] = OrderedDict()
_lock = threading.Lock()


def find_possible(facts: Facts, report: Report = no_report) -> Possible:
    """Find a layout that obeys the rules, or prove that there is none; both may fail.

    The answer follows from the rules alone and is remembered: a batch pays for it once.

    Args:
        facts: the constraints.
        report: told what is being done, and from 0 to 1 how much of it is.
    """
    key = _key_of(facts.rules)
    with _lock:
        if key not in _answers:
            _answers[key] = _decide(facts, report)
            while len(_answers) > REMEMBERED:
                _answers.popitem(last=False)
        return _answers[key]


def _key_of(rules: Rules) -> bytes:
    """Name rules by their content, costs left out."""
    words = (rules.tiles, rules.counts, rules.adjacency, rules.connected, rules.aisle)
    return repr((words, rules.allowed.shape)).encode() + np.packbits(rules.allowed).tobytes()


def _decide(facts: Facts, report: Report) -> Possible:
    """Ask the relaxation, then the solver or the packer."""
    if facts.free_cells > MAX_CELLS:
        return UNKNOWN
    report("asking whether any layout exists", 0.0)
    if is_refuted(facts):
        return IMPOSSIBLE
    if facts.free_cells <= BRANCHED_CELLS:
        return _branch(facts)
    layout = pack(facts, report)
    return UNKNOWN if layout is None else Possible(RepairStatus.ANNEALED, layout)


def _any_layout(facts: Facts) -> np.ndarray:
    """Give a layout to count changes from, which cost nothing here (int8 [H, W])."""
    layout: np.ndarray = facts.rules.allowed.argmax(-1).astype(np.int8)
    return layout


def _state(facts: Facts) -> Program:
    """State the rules, all layouts alike."""
    program = build(_any_layout(facts), facts)
    return program._replace(cost=np.zeros_like(program.cost), constant=0.0)


def is_refuted(facts: Facts) -> bool:
    """Tell whether not even the relaxation has a solution: then no layout obeys the rules."""
    solver = solve_relaxation(span(_state(facts), facts))
    return bool(solver.getModelStatus() == highspy.HighsModelStatus.kInfeasible)


def _branch(facts: Facts) -> Possible:
    """Solve with more and more connectivity cuts, until a layout obeys every rule or none can."""
    program, layout, rng = _state(facts), _any_layout(facts), np.random.default_rng(0)
    if facts.rules.aisle <= 1:  # wide aisles say more than a tree, which takes ten times as long
        program = span(program, facts)
    solver = load(program, 0)
    solver.setOptionValue("mip_max_nodes", NODES)
    for _ in range(ROUNDS):
        _run_limited(solver)
        status = solver.getModelStatus()
        if status == highspy.HighsModelStatus.kInfeasible:
            return IMPOSSIBLE
        if status != highspy.HighsModelStatus.kOptimal:
            break
        values = read_values(solver)[: program.variables.total]
        found = read_layout(program, values, layout, facts, rng)
        cuts = separate(facts.driving[found], facts.must(facts.rules.connected))
        for candidate in (found, mend(found, found, facts, rng)):
            if not audit(candidate, facts.rules):
                return Possible(RepairStatus.ANNEALED, candidate)
        if not cuts:
            break
        add_cuts(solver, program, facts, cuts)
    return UNKNOWN


def _run_limited(solver: highspy.Highs) -> None:
    """Solve until the solver has asked often enough whether to go on: the same on any machine."""
    asked = [0]

    def count(event: highspy.HighsCallbackEvent) -> None:
        asked[0] += 1
        event.interrupt(asked[0] > ASKED)

    solver.cbMipInterrupt.subscribe(count)
    solver.run()
    solver.cbMipInterrupt.unsubscribe(count)
