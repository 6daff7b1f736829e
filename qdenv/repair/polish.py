"""HiGHS on the repair program: a bound from the relaxation, then branch and cut from a start."""

from typing import NamedTuple

import highspy
import numpy as np

from qdenv.repair.anneal import anneal
from qdenv.repair.audit import audit
from qdenv.repair.cuts import Cut, separate
from qdenv.repair.kinds import hand_out
from qdenv.repair.program import Program, build, decode, encode, group_tiles
from qdenv.types import RepairStatus, Rules

SMALL = 500  # variables of a program that the solver closes in a second whatever its gap


class Limits(NamedTuple):
    """When the solver stops; all but `seconds` are deterministic.

    Attributes:
        gap: relative gap.
        hope: skip branching when the relaxation's gap is larger than this: it would not pay on
            programs of more than `SMALL` variables.
        nodes: branch-and-bound nodes of one solve.
        checks: times the solver may ask whether to go on, which it does once per round of work.
        rounds: solves, each with more connectivity cuts.
        seconds: wall-clock safety net of one solve.
    """

    gap: float
    hope: float
    nodes: int
    checks: int
    rounds: int
    seconds: float


class Polished(NamedTuple):
    """What the solver made of an annealed layout."""

    layout: np.ndarray
    price: float
    bound: float
    status: RepairStatus


def load(program: Program, seed: int) -> highspy.Highs:
    """Pass the program to a fresh single-threaded solver."""
    solver = highspy.Highs()
    options = {"output_flag": False, "threads": 1, "random_seed": seed % (1 << 31)}
    for name, value in options.items():
        solver.setOptionValue(name, value)
    model = highspy.HighsLp()
    model.num_col_, model.num_row_ = program.cost.size, program.low.size
    model.col_cost_, model.offset_ = program.cost, program.constant
    model.col_lower_, model.col_upper_ = np.zeros(program.cost.size), program.top
    model.row_lower_, model.row_upper_ = program.low, program.high
    model.a_matrix_.format_ = highspy.MatrixFormat.kRowwise
    model.a_matrix_.start_ = program.rows.indptr.astype(np.int32)
    model.a_matrix_.index_ = program.rows.indices.astype(np.int32)
    model.a_matrix_.value_ = program.rows.data
    integer, real = highspy.HighsVarType.kInteger, highspy.HighsVarType.kContinuous
    model.integrality_ = [integer if whole else real for whole in program.integer]
    solver.passModel(model)
    return solver


def relaxation_bound(program: Program, whole: bool) -> float:
    """Bound the price from below by the linear relaxation (interior point, no crossover).

    Args:
        program: the program.
        whole: every price is an integer, so the bound rounds up.
    """
    solver = load(program, 0)
    for name, value in {"solve_relaxation": True, "solver": "ipm", "run_crossover": "off"}.items():
        solver.setOptionValue(name, value)
    solver.run()
    if solver.getModelStatus() != highspy.HighsModelStatus.kOptimal:
        return 0.0
    bound = solver.getInfo().objective_function_value
    return _round_up(bound, whole)


def _round_up(bound: float, whole: bool) -> float:
    """Round a bound up to the next possible price, with care for solver tolerances."""
    slack = 1e-4 + 1e-6 * abs(bound)
    return float(np.ceil(bound - slack)) if whole else bound - slack


def polish(
    layout: np.ndarray,
    rules: Rules,
    start: np.ndarray,
    price: float,
    bound: float,
    seed: int,
    limits: Limits,
) -> Polished:
    """Improve a feasible layout with the solver, and bound what is possible.

    Args:
        layout: int8 [H, W], the input.
        rules: the constraints.
        start: int8 [H, W], a feasible layout.
        price: its price.
        bound: a known lower bound.
        seed: the solver's.
        limits: when to stop.

    Returns:
        The best layout found, never worse than `start`, with the status of the last solve.
    """
    program = build(layout, rules)
    relaxed = relaxation_bound(program, _whole_prices(rules))
    best = Polished(start, price, max(bound, relaxed), RepairStatus.ANNEALED)
    if best.bound >= price * (1 - limits.gap) - 1e-6:
        return best._replace(status=RepairStatus.OPTIMAL)
    if program.cost.size > SMALL and best.bound < price * (1 - limits.hope):
        return best
    solver, rng = load(program, seed), np.random.default_rng(seed)
    for _ in range(limits.rounds):
        stopped = _solve(solver, encode(program, best.layout, rules, layout), limits)
        best, cuts = _learn(solver, program, best, layout, rules, rng)
        if best.bound >= best.price * (1 - limits.gap) - 1e-6:
            return best._replace(status=RepairStatus.OPTIMAL)
        # The solver's optimum is one of the program without the connectivity still to be cut in.
        unproven = RepairStatus.NODE_LIMIT if stopped == RepairStatus.OPTIMAL else stopped
        best = best._replace(status=unproven)
        if not cuts or stopped == RepairStatus.TIME_LIMIT:
            break
        _add_cuts(solver, program, rules, cuts)
    return best


def _learn(
    solver: highspy.Highs,
    program: Program,
    best: Polished,
    layout: np.ndarray,
    rules: Rules,
    rng: np.random.Generator,
) -> tuple[Polished, list[Cut]]:
    """Take the bound and the layout from a solve; returns cuts where that layout falls apart."""
    whole = _whole_prices(rules)
    bound = _round_up(solver.getInfo().mip_dual_bound, whole)
    roles = decode(program, np.array(solver.getSolution().col_value), layout.shape)
    found = hand_out(roles, layout, rules, rng)
    drives = _drives_tile(rules)
    always = ~(rules.allowed & ~drives).any(-1)
    cuts = separate(drives[found], always) if rules.connected else []
    if cuts:
        # A short cold run from there mends the connections nearby.
        moves, seed = 300 * layout.size, int(rng.integers(1 << 62))
        found, _ = anneal(layout, rules, seed, moves, found, (0.15, 0.1), (2.5, 2.5))
    return _better(best._replace(bound=max(best.bound, bound)), found, layout, rules), cuts


def _whole_prices(rules: Rules) -> bool:
    """Whether every price is an integer, so that bounds round up."""
    return bool((np.asarray(rules.change_cost) % 1 == 0).all())


def _drives_tile(rules: Rules) -> np.ndarray:
    """Mark the tiles of the connected group (bool [K])."""
    return np.array([tile in rules.connected for tile in rules.tiles])


def _solve(solver: highspy.Highs, start: np.ndarray, limits: Limits) -> RepairStatus:
    """Run the solver from a start within its limits; returns which limit ended it."""
    solver.setOptionValue("mip_rel_gap", limits.gap)
    solver.setOptionValue("mip_max_nodes", limits.nodes)
    solver.setOptionValue("time_limit", limits.seconds)
    solution, checks = highspy.HighsSolution(), [0]
    solution.col_value = list(start)
    solver.setSolution(solution)

    def count(event: highspy.HighsCallbackEvent) -> None:
        # The solver asks at fixed points of its work: counting them stops it reproducibly.
        checks[0] += 1
        event.interrupt(checks[0] > limits.checks)

    solver.cbMipInterrupt.subscribe(count)
    solver.run()
    solver.cbMipInterrupt.unsubscribe(count)
    status = solver.getModelStatus()
    if status == highspy.HighsModelStatus.kOptimal:
        return RepairStatus.OPTIMAL
    timed_out = status == highspy.HighsModelStatus.kTimeLimit
    return RepairStatus.TIME_LIMIT if timed_out else RepairStatus.NODE_LIMIT


def _better(best: Polished, found: np.ndarray | None, layout: np.ndarray, rules: Rules) -> Polished:
    """Keep the cheaper of two layouts; an audit guards against whatever the solver returned."""
    if found is None or audit(found, rules):
        return best
    price = float((rules.change_cost * (found != layout)).sum())
    return best._replace(layout=found, price=price) if price < best.price - 1e-9 else best


def _add_cuts(solver: highspy.Highs, program: Program, rules: Rules, cuts: list[Cut]) -> None:
    """Add connectivity cuts as rows."""
    drives = group_tiles(rules, program.roles, program.holds, rules.connected)
    for cut in cuts:
        weights = np.zeros(drives.offset.size)
        weights[cut.ends], weights[cut.gates] = 1.0, -1.0
        row = drives.combined(weights)
        high = len(cut.ends) - 1 - row.offset[0]
        indices = row.matrix.indices.astype(np.int32)
        solver.addRow(-np.inf, high, indices.size, indices, row.matrix.data)
