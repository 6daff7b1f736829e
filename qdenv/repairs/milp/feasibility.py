"""Whether any layout obeys the rules, whatever the input: one that does, or a proof of none.

Needed where annealing fails, up to 20,000 free cells. The relaxation with a spanning tree in it
(`_span`) refutes most of what is impossible; up to 120 cells are decided by branch and cut, more
are packed (`anneal.packing`).
"""

import threading
from collections import OrderedDict

import highspy
import numpy as np
from scipy import ndimage

from qdenv.grid import MOVES, count_neighbours, shift
from qdenv.progress import Progress, silent
from qdenv.repairs.anneal.loop import LOW_PENALTY, anneal
from qdenv.repairs.anneal.packing import draw_templates, pack
from qdenv.repairs.audit import audit
from qdenv.repairs.milp import highs
from qdenv.repairs.milp.program import Constraints, Program, at_least, build, decode
from qdenv.repairs.rules import Facts, assign_kinds, impossible
from qdenv.types import RepairStatus, Rules

_BRANCHED_CELLS = 120  # that may change: with more, branching decides little
_NODES = 2000  # of one solve
_INTERRUPT_BUDGET = 2000  # of one solve
_ROUNDS = 40  # solves, each with more connectivity cuts
_CACHED_RULES = 32
_TOLERANCE = 1e-3  # of the greatest number that a relaxation has room for
_STARTS = 8  # regular layouts to search a layout from
_MOVES_PER_CELL = 560  # of such a search

_answers: OrderedDict[bytes, tuple[RepairStatus, np.ndarray | None]] = OrderedDict()
_lock = threading.Lock()


def find_possible(
    facts: Facts, progress: Progress = silent
) -> tuple[RepairStatus, np.ndarray | None]:
    """Find a layout that obeys the rules, or prove that there is none; both may fail.

    Returns `ANNEALED` and a layout (int8 [H, W]), `IMPOSSIBLE` where none exists, else `FAILED`.
    """
    # Cached by the content of the rules, without costs: a batch pays for it once.
    rules = facts.rules._replace(change_cost=np.zeros_like(facts.rules.change_cost))
    texts = (rules.tiles, rules.counts, rules.adjacency, rules.connected, rules.covers)
    stated = repr((*texts, rules.straight, rules.allowed.shape))
    key = stated.encode() + np.packbits(rules.allowed).tobytes()
    with _lock:
        if key not in _answers:
            _answers[key] = _decide(Facts(rules), progress)
            while len(_answers) > _CACHED_RULES:
                _answers.popitem(last=False)
        return _answers[key]


def explain(rules: Rules, progress: Progress = silent) -> str | None:
    """Return why no layout obeys the rules, as counting or a proof shows; None where one may."""
    reason, facts = impossible(rules), Facts(rules)
    if reason or find_possible(facts, progress)[0] != RepairStatus.IMPOSSIBLE:
        return reason
    for index, bound in enumerate(rules.counts):
        # How many are there at most, where none is required?
        counts = list(rules.counts)
        counts[index] = bound._replace(low=0)
        program = build_free(Facts(rules._replace(counts=tuple(counts))), spanned=True)
        values, constant = program.cells.express(facts.roles_of(bound.tiles))
        used, cost = program.cells.columns >= 0, program.cost.copy()
        cost[program.cells.columns[used]] = -values[used]
        relaxed = highs.solve_relaxation(program._replace(cost=cost, constant=-constant.sum()))
        most = int(-relaxed.getInfo().objective_function_value + _TOLERANCE)
        optimal = relaxed.getModelStatus() == highspy.HighsModelStatus.kOptimal
        if optimal and most < bound.low:
            number = f"the number of {rules.name(bound.tiles, many=True)} must be"
            return f"{number} at least {bound.low} but at most {most} can be reached"
    return "the rules exclude one another, as an integer program shows"


def _decide(facts: Facts, progress: Progress) -> tuple[RepairStatus, np.ndarray | None]:
    """Anneal, where that is fast, then try the relaxation, then the solver or the packer.

    Changes cost nothing in the rules of `facts`.
    """
    if facts.free_cells > highs.MAX_CELLS:
        return RepairStatus.FAILED, None
    # An annealer that pays nothing for changes is faster than a relaxation.
    if facts.rules.covers or facts.rules.straight:
        layout = _search(facts, progress)
        if layout is not None:
            return RepairStatus.ANNEALED, layout
    progress("checking whether any layout exists", 0.0, "")
    relaxed = highs.solve_relaxation(build_free(facts, spanned=True))
    if relaxed.getModelStatus() == highspy.HighsModelStatus.kInfeasible:
        return RepairStatus.IMPOSSIBLE, None
    if facts.free_cells > _BRANCHED_CELLS:
        layout = pack(facts.straightened(facts.any_layout), progress)
        return RepairStatus.FAILED if layout is None else RepairStatus.ANNEALED, layout
    # Solve with more and more connectivity cuts, until a layout obeys every rule or none can. Wide
    # aisles exclude more than a tree, which takes ten times as long.
    program, rng = build_free(facts, spanned=not facts.rules.covers), np.random.default_rng(0)
    solver = highs.load(highs.new_solver(0), program)
    solver.setOptionValue("mip_max_nodes", _NODES)
    for _ in range(_ROUNDS):
        highs.run_limited(solver, _INTERRUPT_BUDGET)
        status = solver.getModelStatus()
        if status == highspy.HighsModelStatus.kInfeasible:
            return RepairStatus.IMPOSSIBLE, None
        if status != highspy.HighsModelStatus.kOptimal:
            break
        roles = decode(program.cells, np.array(solver.getSolution().col_value))
        solution = assign_kinds(roles, facts.any_layout, facts, rng)
        cuts = highs.separate(facts.driving[solution], facts.must(facts.rules.connected))
        for candidate in (solution, highs.mend(solution, solution, facts, rng)):
            if not audit(candidate, facts.rules):
                return RepairStatus.ANNEALED, candidate
        if not cuts:
            break
        highs.add_cuts(solver, program.cells, facts, cuts)
    return RepairStatus.FAILED, None


def _search(facts: Facts, progress: Progress) -> np.ndarray | None:
    """Anneal from regular layouts and from open floor."""
    starts = [*draw_templates(facts.any_layout, facts)[:_STARTS], facts.any_layout]
    for seed, start in enumerate(starts):
        moves = _MOVES_PER_CELL * facts.free_cells
        straight = facts.straightened(start)
        found, _ = anneal(start, straight, seed, moves, start, LOW_PENALTY, progress, bound=0.0)
        if found is not None and not audit(found, facts.rules):
            return found
    return None


def build_free(facts: Facts, spanned: bool) -> Program:
    """Build the program in which every layout costs nothing; `spanned` with `_span`'s rows."""
    program = build(facts.any_layout, facts)
    program = program._replace(cost=np.zeros_like(program.cost), constant=0.0)
    parts = [_surround] if any(facts.widens) else []
    parts += [_span] if spanned and facts.rules.connected else []
    for part in parts:
        more, rows = part(program, facts)
        program = program._replace(
            cost=np.pad(program.cost, (0, more)),
            upper=np.pad(program.upper, (0, more), constant_values=1.0),
            integer=np.pad(program.integer, (0, more)),
            rows=[*program.rows, *rows],
        )
    return program


def _surround(program: Program, facts: Facts) -> tuple[int, list[Constraints]]:
    """Bound what lies beside wide aisles by their cells, see `Facts.spare_ring`.

    That is every obstacle which they serve, and walls and the outside where they run along them. A
    (continuous) variable for each wall stands behind the others. Returns their number and the rows.
    """
    rules, first, shape = facts.rules, program.cost.size, facts.free.shape
    rule = rules.covers[facts.widens.index(True)]
    served = "".join(
        tile
        for tile in rules.tiles
        if tile not in rules.connected and any(tile in rule.tiles for rule in facts.services)
    )
    may, columns = facts.may(rules.connected), program.cells.columns
    walls = ~may & ~facts.may(served) & (count_neighbours(may) > 0)
    wall = np.where(walls, first + np.cumsum(walls).reshape(shape) - 1, -1)
    (own, drives), (held, holds) = (
        program.cells.express(facts.roles_of(tiles)) for tiles in (rules.connected, served)
    )
    rows = []
    for move in MOVES:
        # The wall beside a cell, -1 for none: it counts once, however many cells it is beside.
        beside = np.asarray(shift(wall, move, -1))
        here = may & (beside >= 0)
        rows.append(at_least(drives[here], (columns[here], -own[here]), (beside[here], 1.0)))
    outside = 4 - count_neighbours(np.ones(shape, bool))
    weight = np.where(facts.room(rule), 1.0, 2.0) - outside
    values = (weight[..., None] * own - held).reshape(1, -1)
    least = np.array([-facts.spare_ring(rule) - (weight * drives - holds).sum()])
    rows.append(
        at_least(least, (columns.reshape(1, -1), values), (wall[walls].reshape(1, -1), -1.0))
    )
    return int(walls.sum()), rows


def _span(program: Program, facts: Facts) -> tuple[int, list[Constraints]]:
    """State a spanning tree and who serves whom: the same layouts, a tighter relaxation.

    If the driving area is one piece, its n cells have a spanning tree of n - 1 edges. A side of a
    driving cell is an edge of the tree or serves one obstacle, so a part of c cells serves 2 c + 1
    obstacles at most: what `rules.impossible` counts for a whole layout, here the solver may state
    of any part of it. Cells that always drive and hang together count as one. Returns the
    number of (continuous) variables, which stand behind the others, and the rows.
    """
    connected = facts.rules.connected
    (height, width), first = facts.free.shape, program.cost.size
    cell = np.arange(facts.free.size).reshape(facts.free.shape)
    always = facts.must(connected).ravel()
    # The pairs of neighbours: all to the right, then all below.
    one = np.concatenate([cell[:, :-1].ravel(), cell[:-1].ravel()])
    other = np.concatenate([cell[:, 1:].ravel(), cell[1:].ravel()])
    pair = ~(always[one] & always[other])  # no edges within what always drives
    count = int(pair.sum())
    edge = np.where(pair, first + np.cumsum(pair) - 1, -1)
    right = edge[: height * (width - 1)].reshape(height, -1)
    below = edge[right.size :].reshape(-1, width)
    # Sides are pairs with a direction: those of all pairs, then the same reversed.
    start = np.concatenate([one[pair], other[pair]])
    end = np.concatenate([other[pair], one[pair]])
    side_edge = np.tile(edge[pair], 2)
    columns = program.cells.columns.reshape(cell.size, -1)

    def express(tiles: str) -> tuple[np.ndarray, np.ndarray]:
        """Express which cells hold one of `tiles`, a row for each cell."""
        own, constant = program.cells.express(facts.roles_of(tiles))
        return own.reshape(cell.size, -1), constant.ravel()

    own, drives = express(connected)
    labels, parts = ndimage.label(always.reshape(height, width))
    rows = [
        # An edge of the tree needs both its cells to drive.
        at_least(-drives[start], (columns[start], own[start]), (side_edge, -1.0)),
        # The tree has an edge less than the driving area has cells, fixed parts counted as one.
        at_least(
            np.array([drives[~always].sum() + parts - 1.0]),
            (edge[pair][None], 1.0),
            (columns.reshape(1, -1), -(own * ~always[:, None]).reshape(1, -1)),
        ),
        *_break_rings(columns, own, drives, labels, right, below),
    ]
    # The direction of a side, as seen from its end: no two sides share it and the end.
    towards = np.repeat([0, 1], [right.size, below.size])[pair]
    towards = np.concatenate([towards, towards + 2])
    # Those of obstacles.
    services = [rule for rule in facts.services if not set(rule.tiles) & set(connected)]
    for place, rule in enumerate(services):
        # Every obstacle is served over a side, which is no edge of the tree then.
        used = first + count * (1 + 2 * place) + np.arange(2 * count)
        (server, serves), (obstacle, stands) = express(rule.needs), express(rule.tiles)
        into = np.full((cell.size, 4), -1)
        into[end, towards] = used
        may = facts.may(rule.tiles).ravel()
        rows += [
            at_least(-serves[start], (columns[start], server[start]), (used, -1.0)),
            at_least(-stands[end], (columns[end], obstacle[end]), (used, -1.0)),
            at_least(-drives[start], (columns[start], own[start]), (side_edge, -1.0), (used, -1.0)),
            at_least(stands[may], (into[may], 1.0), (columns[may], -obstacle[may])),
        ]
    return count * (1 + 2 * len(services)), rows


def _break_rings(
    columns: np.ndarray,
    own: np.ndarray,
    drives: np.ndarray,
    labels: np.ndarray,
    right: np.ndarray,
    below: np.ndarray,
) -> list[Constraints]:
    """Bound tree edges in a square of four cells: one fewer than driving cells.

    `own` (float64 [cells, R]) are the coefficients of "the cell drives" and `drives` its constants;
    `labels` (int64 [H, W]) number the parts of what always drives, from 1 on; `right` (int64
    [H, W - 1]) and `below` (int64 [H - 1, W]) are the edges to the next cell, -1 for none.
    """
    width = labels.shape[1]
    corner = np.arange(labels.size).reshape(labels.shape)[:-1, :-1].ravel()
    square = corner[:, None] + np.array([0, 1, width, width + 1])
    edges = np.stack([right[:-1], right[1:], below[:, :-1], below[:, 1:]], -1).reshape(-1, 4)
    part = np.sort(labels.ravel()[square], 1)
    fixed = (part[:, 0] > 0) + ((part[:, 1:] != part[:, :-1]) & (part[:, 1:] > 0)).sum(1)

    def less_edges(rows: np.ndarray, cells: np.ndarray, low: np.ndarray) -> Constraints:
        loose = labels.ravel()[cells] == 0
        shape = (len(cells), cells.shape[1] * columns.shape[1])
        terms = (own[cells] * loose[..., None]).reshape(shape)
        low = low - (drives[cells] * loose).sum(1)
        return at_least(low, (columns[cells].reshape(shape), terms), (edges[rows], -1.0))

    # What always drives counts as one cell, which is the one less.
    found = [less_edges(fixed > 0, square[fixed > 0], 1.0 - fixed[fixed > 0])]
    open_squares = square[fixed == 0]
    for place in range(4):
        others = np.delete(open_squares, place, 1)
        found.append(less_edges(fixed == 0, others, np.zeros(len(others))))
    return found
