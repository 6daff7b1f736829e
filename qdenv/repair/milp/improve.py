"""Improve an annealed layout: a bound from the relaxation, then branch and cut from a start."""

import numpy as np

from qdenv.repair.anneal.annealer import COLD, anneal
from qdenv.repair.audit import audit
from qdenv.repair.facts import Facts
from qdenv.repair.kinds import hand_out
from qdenv.repair.milp.cuts import separate
from qdenv.repair.milp.highs import (
    add_cuts,
    bound_relaxation,
    load,
    read_bound,
    read_values,
    solve,
)
from qdenv.repair.milp.program import Program, build, decode, encode
from qdenv.repair.result import Result
from qdenv.repair.settings import MilpLimits, RepairConfig
from qdenv.types import RepairStatus

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
