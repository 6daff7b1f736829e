"""Fast feasible layouts: one run of simulated annealing."""

from typing import NamedTuple

import numpy as np

from qdenv.repair.anneal.loop import anneal_periods
from qdenv.repair.anneal.start import (
    compile_board,
    initial_aisles,
    initial_state,
    project,
    unpad_layout,
)
from qdenv.repair.anneal.state import Board, Plan, no_move
from qdenv.repair.facts import Facts
from qdenv.repair.result import Report, no_report

PERIODS = 1000  # times the schedule moves on in one run
CHUNK = 2_000_000  # moves between two reports, a fraction of a second


class Schedule(NamedTuple):
    """How a run cools down and grows strict."""

    temperatures: tuple[float, float]  # the first and the last, in units of the mean cost of a cell
    # the first and the last cost of a broken demand, in units of the largest cost of a cell
    penalty_weights: tuple[float, float]


# Chosen on published and random layouts of the paper's sizes: a last penalty weight of 1.5 and less
# left layouts infeasible.
GENTLE = Schedule((0.3, 0.1), (0.6, 2.2))
FIRM = Schedule((0.5, 0.1), (2.0, 8.0))
# No move may break a rule: from a start that obeys all of them, feasibility cannot be lost.
STRICT = Schedule((0.3, 0.1), (20.0, 20.0))
# Mends the connections of an almost feasible layout and leaves the rest as it is.
COLD = Schedule((0.15, 0.1), (2.5, 2.5))


def anneal(
    layout: np.ndarray,
    facts: Facts,
    seed: int,
    moves: int,
    start: np.ndarray,
    schedule: Schedule = GENTLE,
    report: Report = no_report,
    bound: float = -np.inf,
) -> tuple[np.ndarray | None, float]:
    """Find a cheap layout that obeys every rule.

    Args:
        layout: int8 [H, W], the input from which changes are counted.
        facts: the constraints.
        seed: any integer; the same seed gives the same layout.
        moves: proposed moves.
        start: int8 [H, W], where to start; the input itself will do.
        schedule: how to cool down.
        report: told now and then which share of the moves is done.
        bound: no layout costs less: reaching it ends the run, and changes nothing else.

    Returns:
        The best feasible layout (int8 [H, W]) and its cost, or (None, inf).
    """
    board, rng = compile_board(layout, facts), np.random.default_rng(abs(seed))
    candidate, move = project(board, start, rng), no_move()
    aisles = initial_aisles(board, candidate, facts.rules.aisle)
    state = initial_state(board, candidate, aisles)
    plan = _make_plan(board, int(rng.integers(1 << 63)), moves, schedule, bound)
    # In pieces, so that a long run can tell how far it is.
    chunk = max(CHUNK // plan.period, 1)
    for first in range(0, plan.periods, chunk):
        last = min(first + chunk, plan.periods)
        anneal_periods(board, state, aisles, move, plan, first, last)
        report("annealing", last / plan.periods)
    if not np.isfinite(state.sums[1]):
        return None, float("inf")
    best = unpad_layout(state.best, int(board.steps[4]))
    return best, facts.cost(best, layout)


def _make_plan(board: Board, seed: int, moves: int, schedule: Schedule, bound: float) -> Plan:
    """Turn a schedule into numbers for one board."""
    costs, moves = board.change_cost[board.free], moves if board.free.size else 0
    mean, top = (float(costs.mean()), float(costs.max())) if costs.any() else (1.0, 1.0)
    period = max(moves // PERIODS, 1)
    return Plan(
        seed=np.uint64(seed),
        moves=moves,
        period=period,
        periods=max(-(-moves // period), 1),
        temperatures=(schedule.temperatures[0] * mean, schedule.temperatures[1] * mean),
        penalty_weights=(schedule.penalty_weights[0] * top, schedule.penalty_weights[1] * top),
        enough=bound,
    )
