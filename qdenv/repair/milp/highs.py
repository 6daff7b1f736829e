"""Cuts that forbid the disconnections of one solution of the program.

Connectivity as lazy inequalities over minimal separators (Carvajal et al. 2013,
https://doi.org/10.1287/opre.2013.1183; Fischetti et al. 2017,
https://doi.org/10.1007/s12532-016-0111-0): stated up front there would be exponentially many, and
few of them matter.
"""

from typing import NamedTuple

import highspy
import numpy as np
from scipy import ndimage

from qdenv.repair.anneal.loop import COLD, anneal
from qdenv.repair.audit import audit
from qdenv.repair.milp.program import Program, build, decode, encode
from qdenv.repair.rules import Facts, Result, hand_out
from qdenv.repair.settings import MilpLimits, RepairConfig
from qdenv.types import RepairStatus

CROSS = ndimage.generate_binary_structure(2, 1)


class Cut(NamedTuple):
    """If both ends drive, so does a gate: driving(ends) - sum driving(gates) <= ends - 1."""

    ends: list[int]  # positions; one where the main part always drives, else one in either part
    gates: list[int]  # positions of a separator: every path between the ends crosses one of them


def separate(driving: np.ndarray, always: np.ndarray, most: int = 4) -> list[Cut]:
    """Find cuts for every part of the driving area that is cut off from the main one.

    Args:
        driving: bool [H, W], the driving area of a solution.
        always: bool [H, W], cells that drive in every layout.
        most: cells of each part to cut for.

    Returns:
        Cuts through minimal separators; empty when the area is one piece.
    """
    labels, parts = ndimage.label(driving, CROSS)
    if parts <= 1:
        return []
    sizes = np.bincount(labels.ravel())[1:]
    anchored = np.unique(labels[always & driving])
    main = int(anchored[0]) if anchored.size else 1 + int(np.argmax(sizes))
    anchor = np.argwhere(labels == main)[0]
    # Where the main part always drives, its end needs no variable and the cut is tighter.
    other = [] if anchored.size else [int(np.ravel_multi_index(tuple(anchor), driving.shape))]
    cuts = []
    for part in range(1, parts + 1):
        if part == main:
            continue
        inside = labels == part
        gates = np.flatnonzero(_separator(inside, anchor)).tolist()
        cells = np.flatnonzero(inside)
        for cell in cells[np.linspace(0, cells.size - 1, min(most, cells.size)).astype(int)]:
            cuts.append(Cut([int(cell), *other], gates))
    return cuts


def _separator(inside: np.ndarray, anchor: np.ndarray) -> np.ndarray:
    """Mark the cells around a part that face the anchor's side (bool [H, W]).

    Of the shell only these: what lies in pockets behind it separates nothing.
    """
    shell = ndimage.binary_dilation(inside, CROSS) & ~inside
    beyond, _ = ndimage.label(~shell & ~inside, CROSS)
    outside = beyond == beyond[tuple(anchor)]
    return shell & ndimage.binary_dilation(outside, CROSS)


def load(program: Program, seed: int) -> highspy.Highs:
    """Pass the program to a fresh single-threaded solver."""
    solver = highspy.Highs()
    options = {"output_flag": False, "threads": 1, "random_seed": seed % (1 << 31)}
    for name, value in options.items():
        solver.setOptionValue(name, value)
    model = highspy.HighsLp()
    model.num_col_, model.num_row_ = program.cost.size, program.low.size
    model.col_cost_, model.offset_ = program.cost, program.constant
    model.col_lower_, model.col_upper_ = np.zeros(program.cost.size), program.upper
    model.row_lower_, model.row_upper_ = program.low, program.high
    model.a_matrix_.format_ = highspy.MatrixFormat.kRowwise
    model.a_matrix_.start_ = program.rows.indptr.astype(np.int32)
    model.a_matrix_.index_ = program.rows.indices.astype(np.int32)
    model.a_matrix_.value_ = program.rows.data
    integer, real = highspy.HighsVarType.kInteger, highspy.HighsVarType.kContinuous
    model.integrality_ = [integer if whole else real for whole in program.integer]
    solver.passModel(model)
    return solver


def bound_relaxation(program: Program, facts: Facts) -> float:
    """Bound the cost from below by the linear relaxation."""
    solver = solve_relaxation(program)
    if solver.getModelStatus() != highspy.HighsModelStatus.kOptimal:
        return 0.0
    return _round_up(solver.getInfo().objective_function_value, facts)


def solve_relaxation(program: Program) -> highspy.Highs:
    """Solve the linear relaxation (interior point, no crossover)."""
    solver = load(program, 0)
    for name, value in {"solve_relaxation": True, "solver": "ipm", "run_crossover": "off"}.items():
        solver.setOptionValue(name, value)
    solver.run()
    return solver


def read_bound(solver: highspy.Highs, facts: Facts) -> float:
    """Read the lower bound on the cost that a solve has proven."""
    return _round_up(solver.getInfo().mip_dual_bound, facts)


def read_values(solver: highspy.Highs) -> np.ndarray:
    """Read the best solution of a solve (float64 [variables])."""
    return np.array(solver.getSolution().col_value)


def _round_up(bound: float, facts: Facts) -> float:
    """Round a bound up to the next possible cost, with care for solver tolerances."""
    slack = 1e-4 + 1e-6 * abs(bound)
    return float(np.ceil(bound - slack)) if facts.whole_costs else bound - slack


def solve(
    solver: highspy.Highs, start: np.ndarray, gap: float, seconds: float, limits: MilpLimits
) -> RepairStatus:
    """Run the solver from a start within its limits.

    Args:
        solver: what `load` made; keeps what it finds.
        start: float64 [variables], a feasible solution.
        gap: relative gap at which to stop.
        seconds: wall-clock safety net.
        limits: the deterministic limits.

    Returns:
        `OPTIMAL` (for the program as it stands), or which limit ended the run.
    """
    solver.setOptionValue("mip_rel_gap", gap)
    solver.setOptionValue("mip_max_nodes", limits.node_limit)
    solver.setOptionValue("time_limit", seconds)
    solution, asked = highspy.HighsSolution(), [0]
    solution.col_value = list(start)
    solver.setSolution(solution)

    def count(event: highspy.HighsCallbackEvent) -> None:
        # The solver asks at fixed points of its work: counting them stops it reproducibly, which
        # a time limit would not.
        asked[0] += 1
        event.interrupt(asked[0] > limits.interrupt_budget)

    solver.cbMipInterrupt.subscribe(count)
    solver.run()
    solver.cbMipInterrupt.unsubscribe(count)
    status = solver.getModelStatus()
    if status == highspy.HighsModelStatus.kOptimal:
        return RepairStatus.OPTIMAL
    timed_out = status == highspy.HighsModelStatus.kTimeLimit
    return RepairStatus.TIME_LIMIT if timed_out else RepairStatus.NODE_LIMIT


def add_cuts(solver: highspy.Highs, program: Program, facts: Facts, cuts: list[Cut]) -> None:
    """Add connectivity cuts as rows."""
    driving = program.variables.group(facts, facts.rules.connected)
    for cut in cuts:
        weights = np.zeros(driving.offset.size)
        weights[cut.ends], weights[cut.gates] = 1.0, -1.0
        row = driving.combined(weights)
        high = len(cut.ends) - 1 - row.offset[0]
        indices = row.matrix.indices.astype(np.int32)
        solver.addRow(-np.inf, high, indices.size, indices, row.matrix.data)


SMALL = 500  # variables of a program that the solver closes in a second whatever its gap
MENDING_MOVES = 300  # annealing moves per cell that mend a solution's connections


def improve(
    layout: np.ndarray,
    facts: Facts,
    start: Result,
    seed: int,
    config: RepairConfig,
    limits: MilpLimits,
) -> Result:
    """Improve a feasible layout with the solver, and bound what is possible.

    Args:
        layout: int8 [H, W], the input.
        facts: the constraints.
        start: a feasible layout, its cost, and a known lower bound.
        seed: the solver's.
        config: the gap and the wall-clock limit.
        limits: when to branch, and how long.

    Returns:
        The best layout found, never worse than `start`, with the status of the last solve.
    """
    program = build(layout, facts)
    best = start._replace(bound=max(start.bound, bound_relaxation(program, facts)))
    if best.proven(config.gap):
        return best._replace(status=RepairStatus.OPTIMAL)
    if not _worth_branching(program, best, limits):
        return best
    solver, rng = load(program, seed), np.random.default_rng(seed)
    for _ in range(limits.rounds):
        values = encode(program, best.layout, layout, facts)
        stopped = solve(solver, values, config.gap, config.time_limit, limits)
        best = best._replace(bound=max(best.bound, read_bound(solver, facts)))
        candidate = read_layout(program, read_values(solver), layout, facts, rng)
        cuts = []
        if facts.rules.connected:
            cuts = separate(facts.driving[candidate], facts.must(facts.rules.connected))
        if cuts:
            candidate = mend(candidate, layout, facts, rng)
        best = keep_cheaper(best, candidate, layout, facts)
        if best.proven(config.gap):
            return best._replace(status=RepairStatus.OPTIMAL)
        # The solver's optimum is one of the program without the connectivity still to be cut in.
        unproven = RepairStatus.NODE_LIMIT if stopped == RepairStatus.OPTIMAL else stopped
        best = best._replace(status=unproven)
        if not cuts or stopped == RepairStatus.TIME_LIMIT:
            break
        add_cuts(solver, program, facts, cuts)
    return best


def _worth_branching(program: Program, best: Result, limits: MilpLimits) -> bool:
    """Whether branching can be expected to close the gap that the relaxation leaves."""
    if program.variables.total <= SMALL:
        return True
    return best.bound >= best.cost * (1 - limits.max_gap_to_branch)


def read_layout(
    program: Program,
    values: np.ndarray,
    layout: np.ndarray,
    facts: Facts,
    rng: np.random.Generator,
) -> np.ndarray:
    """Read the layout of a solution (int8 [H, W]); its driving area may fall apart."""
    roles = decode(program, values, layout.shape)
    return hand_out(roles, layout, facts, rng)


def mend(
    candidate: np.ndarray, layout: np.ndarray, facts: Facts, rng: np.random.Generator
) -> np.ndarray:
    """Mend the connections of a solution near what it is, or return it as it is."""
    moves, seed = MENDING_MOVES * layout.size, int(rng.integers(1 << 62))
    best, _ = anneal(layout, facts, seed, moves, candidate, COLD)
    return candidate if best is None else best


def keep_cheaper(best: Result, candidate: np.ndarray, layout: np.ndarray, facts: Facts) -> Result:
    """Keep the cheaper of two layouts; an audit guards against whatever the solver returned."""
    if audit(candidate, facts.rules):
        return best
    cost = facts.cost(candidate, layout)
    return best._replace(layout=candidate, cost=cost) if cost < best.cost - 1e-9 else best
