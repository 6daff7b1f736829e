"""HiGHS on the repair program: load it, bound it, cut off what falls apart, improve a layout.

HiGHS: Huangfu and Hall 2018, https://doi.org/10.1007/s12532-017-0130-5, https://highs.dev.
"""

import highspy
import numpy as np
from scipy import ndimage

from qdenv.repairs.anneal.loop import MENDING, anneal
from qdenv.repairs.audit import audit
from qdenv.repairs.milp.program import Cells, Program, build, decode, encode
from qdenv.repairs.rules import Facts, assign_kinds, is_proven
from qdenv.repairs.settings import RepairConfig
from qdenv.types import Repair, RepairStatus

MAX_CELLS = 20_000  # that may change: with more even the relaxation takes minutes
_MAX_GAP = 0.08  # of the relaxation beyond which branching would not pay, in parts of the cost
_SMALL = 500  # variables of a program that the solver closes in a second whatever its gap
# Free cells beyond which nothing branches: at 101 x 102 one heuristic of a factory's root, which
# offers no interruption, takes minutes for a percent; warehouses (9,898 cells) take seconds.
_BRANCHED_CELLS = 10_000
_ROUNDS = 4  # solves, each with more connectivity cuts
_INTERRUPT_BUDGET = 100  # of one solve: a deterministic limit on its work
_MENDING_MOVES = 300  # annealing moves per cell that mend a solution's connections
_CUTS = 4  # for each part that is cut off, at most: one for a cell
_NODES = 1000  # branch-and-bound nodes of one solve, unless configured

# Positions (ends, gates): if all ends drive, so does a gate. Ends are one in the part that is cut
# off and, unless that always drives, one in the main part; every path between the parts crosses one
# of the gates. As a row: sum driving(ends) - sum driving(gates) <= number of ends - 1.
Cut = tuple[list[int], list[int]]


class _Silent(highspy.Highs):
    """A solver that prints nothing, not even who made it when it is made."""

    def enableCallbacks(self) -> None:  # noqa: N802 (the constructor calls it, which prints)
        self.setOptionValue("output_flag", False)
        super().enableCallbacks()


def new_solver(seed: int) -> highspy.Highs:
    """Make a silent solver with one thread."""
    solver = _Silent()
    solver.setOptionValue("threads", 1)
    solver.setOptionValue("random_seed", seed % (1 << 31))
    return solver


def load(solver: highspy.Highs, program: Program) -> highspy.Highs:
    """Pass a program to a solver, which is returned, in place of the one it had."""
    terms = [part.terms() for part in program.rows]
    ends = np.cumsum(np.concatenate([mask.sum(1) for mask in terms]))
    model = highspy.HighsLp()
    model.num_col_, model.num_row_ = program.cost.size, ends.size
    model.col_cost_, model.offset_ = program.cost, program.constant
    model.col_lower_, model.col_upper_ = np.zeros(program.cost.size), program.upper
    model.row_lower_ = np.concatenate([part.low for part in program.rows])
    model.row_upper_ = np.concatenate([part.high for part in program.rows])
    model.a_matrix_.format_ = highspy.MatrixFormat.kRowwise
    model.a_matrix_.start_ = np.append(0, ends).astype(np.int32)
    pairs = list(zip(program.rows, terms, strict=True))
    indices = np.concatenate([part.columns[mask] for part, mask in pairs])
    model.a_matrix_.index_ = indices.astype(np.int32)
    model.a_matrix_.value_ = np.concatenate([part.values[mask] for part, mask in pairs])
    integer, real = highspy.HighsVarType.kInteger, highspy.HighsVarType.kContinuous
    model.integrality_ = [integer if whole else real for whole in program.integer]
    solver.passModel(model)
    return solver


def solve_relaxation(program: Program) -> highspy.Highs:
    """Solve the linear relaxation (interior point, no crossover)."""
    solver = load(new_solver(0), program)
    solver.setOptionValue("solve_relaxation", True)
    solver.setOptionValue("solver", "ipm")
    solver.setOptionValue("run_crossover", "off")
    solver.run()
    return solver


def round_up(bound: float, facts: Facts) -> float:
    """Round a bound up to the next possible cost, with care for solver tolerances."""
    slack = 1e-4 + 1e-6 * abs(bound)
    return float(np.ceil(bound - slack)) if facts.whole_costs else bound - slack


def run_limited(solver: highspy.Highs, budget: int) -> None:
    """Solve until the solver has offered to be interrupted more than `budget` times."""
    # It does so at fixed points of its work: a count is reproducible, a time limit is not.
    offers = 0

    def count(event: highspy.HighsCallbackEvent) -> None:
        nonlocal offers
        offers += 1
        event.interrupt(offers > budget)

    solver.cbMipInterrupt.subscribe(count)
    solver.run()
    solver.cbMipInterrupt.unsubscribe(count)


def mend(
    candidate: np.ndarray, layout: np.ndarray, facts: Facts, rng: np.random.Generator
) -> np.ndarray:
    """Mend the connections of a solution by small changes; return it unchanged where none do."""
    moves, seed = _MENDING_MOVES * layout.size, int(rng.integers(1 << 62))
    best, _ = anneal(layout, facts.straightened(candidate), seed, moves, candidate, MENDING)
    return candidate if best is None else best


def separate(driving: np.ndarray, always: np.ndarray) -> list[Cut]:
    """Find cuts for every part of the driving area that is cut off from the main one.

    Connectivity as lazy inequalities over minimal separators (Carvajal et al. 2013,
    https://doi.org/10.1287/opre.2013.1183; Fischetti et al. 2017,
    https://doi.org/10.1007/s12532-016-0111-0): stated up front there would be exponentially many,
    and few of them matter. `driving` (bool [H, W]) is the driving area of a solution; the cells
    `always` (bool [H, W]) drive in every layout.
    """
    labels, parts = ndimage.label(driving)
    if parts <= 1:
        return []
    anchored = np.unique(labels[always & driving])
    main = int(anchored[0] if anchored.size else 1 + np.bincount(labels.ravel())[1:].argmax())
    anchor = tuple(np.argwhere(labels == main)[0])
    # Where the main part always drives, its end needs no variable and the cut is tighter.
    other = [] if anchored.size else [int(np.ravel_multi_index(anchor, driving.shape))]
    cuts = []
    for part in range(1, parts + 1):
        if part == main:
            continue
        # The gates: of the cells around the part only those that face the anchor's side. What lies
        # in pockets behind them separates nothing.
        inside = labels == part
        shell = ndimage.binary_dilation(inside) & ~inside
        beyond, _ = ndimage.label(~shell & ~inside)
        facing = shell & ndimage.binary_dilation(beyond == beyond[anchor])
        gates, cells = np.flatnonzero(facing).tolist(), np.flatnonzero(inside)
        for cell in cells[np.linspace(0, cells.size - 1, min(_CUTS, cells.size)).astype(int)]:
            cuts.append(([int(cell), *other], gates))
    return cuts


def add_cuts(solver: highspy.Highs, cells: Cells, facts: Facts, cuts: list[Cut]) -> None:
    """Add connectivity cuts, with positions among `cells`, as rows."""
    own, drives = cells.express(facts.roles_of(facts.rules.connected))
    columns, own = (array.reshape(drives.size, -1) for array in (cells.columns, own))
    for ends, gates in cuts:
        places = [*ends, *gates]
        signs = np.repeat([1.0, -1.0], [len(ends), len(gates)])
        values = own[places] * signs[:, None]
        terms = (columns[places] >= 0) & (values != 0)
        indices = columns[places][terms].astype(np.int32)
        high = len(ends) - 1 - drives.ravel()[places] @ signs
        solver.addRow(-np.inf, high, indices.size, indices, values[terms])


def keep_cheaper(best: Repair, candidate: np.ndarray, layout: np.ndarray, facts: Facts) -> Repair:
    """Return the cheaper of two layouts; an audit guards against whatever the solver returned."""
    if audit(candidate, facts.rules):
        return best
    cost = facts.cost(candidate, layout)
    return best._replace(layout=candidate, cost=cost) if cost < best.cost - 1e-9 else best


def improve(
    layout: np.ndarray, facts: Facts, start: Repair, seed: int, config: RepairConfig
) -> Repair:
    """Improve the feasible layout of `start` by branch and cut, and bound what is possible.

    Returns the best layout found for the input `layout` (int8 [H, W]), never worse than `start`,
    OPTIMAL if proven, with the status of `start` if nothing branched, else that of a limit.
    """
    program, best = build(layout, facts), start
    relaxed = solve_relaxation(program)
    if relaxed.getModelStatus() == highspy.HighsModelStatus.kOptimal:
        bound = round_up(relaxed.getInfo().objective_function_value, facts)
        best = best._replace(lower_bound=max(best.lower_bound, bound))
    if is_proven(best, config.gap):
        return best._replace(status=RepairStatus.OPTIMAL)
    # Branching closes small gaps only, but any gap of a small program.
    close = best.lower_bound >= best.cost * (1 - _MAX_GAP)
    if facts.free_cells > _BRANCHED_CELLS or (program.cost.size > _SMALL and not close):
        return best
    solver, rng = load(new_solver(seed), program), np.random.default_rng(seed)
    solver.setOptionValue("mip_rel_gap", config.gap)
    nodes = _NODES if config.node_limit is None else config.node_limit
    solver.setOptionValue("mip_max_nodes", nodes)
    solver.setOptionValue("time_limit", config.time_limit)
    always = facts.must(facts.rules.connected)
    for _ in range(_ROUNDS):
        solution = highspy.HighsSolution()
        solution.col_value = encode(program, np.asarray(best.layout), layout, facts).tolist()
        solver.setSolution(solution)
        run_limited(solver, _INTERRUPT_BUDGET)
        expired = solver.getModelStatus() == highspy.HighsModelStatus.kTimeLimit
        bound = round_up(solver.getInfo().mip_dual_bound, facts)
        best = best._replace(lower_bound=max(best.lower_bound, bound))
        roles = decode(program.cells, np.array(solver.getSolution().col_value))
        candidate = assign_kinds(roles, layout, facts, rng)
        if cuts := separate(facts.driving[candidate], always):
            candidate = mend(candidate, layout, facts, rng)
        best = keep_cheaper(best, candidate, layout, facts)
        if is_proven(best, config.gap):
            return best._replace(status=RepairStatus.OPTIMAL)
        # Even the solver's optimum is one of the program without the connectivity still to be cut
        # in: it proves nothing.
        best = best._replace(status=RepairStatus.TIME_LIMIT if expired else RepairStatus.NODE_LIMIT)
        if not cuts or expired:
            break
        add_cuts(solver, program.cells, facts, cuts)
    return best
