"""Fast feasible layouts: one run of simulated annealing."""

from typing import NamedTuple

import numpy as np

from qdenv.repair.anneal.loop import anneal_loop
from qdenv.repair.anneal.start import compile_board, initial_state, project, unpad_layout
from qdenv.repair.anneal.state import no_move
from qdenv.repair.facts import Facts


class Schedule(NamedTuple):
    """How a run cools down and grows strict.

    Attributes:
        temperatures: the first and the last, in units of the mean cost of a cell.
        penalty_weights: the first and the last cost of a broken demand, in units of the largest
            cost of a cell.
    """

    temperatures: tuple[float, float]
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
) -> tuple[np.ndarray | None, float]:
    """Find a cheap layout that obeys every rule.

    Args:
        layout: int8 [H, W], the input from which changes are counted.
        facts: the constraints.
        seed: any integer; the same seed gives the same layout.
        moves: proposed moves.
        start: int8 [H, W], where to start; the input itself will do.
        schedule: how to cool down.

    Returns:
        The best feasible layout (int8 [H, W]) and its cost, or (None, inf).
    """
    board, rng = compile_board(layout, facts), np.random.default_rng(abs(seed))
    state = initial_state(board, project(board, start, rng))
    costs = board.change_cost[board.free]
    mean, top = (costs.mean(), costs.max()) if costs.any() else (1.0, 1.0)
    (first_temperature, last_temperature), (first_weight, last_weight) = schedule
    cost = anneal_loop(
        board,
        state,
        no_move(),
        rng.integers(1, 2**63, 1).astype(np.uint64),
        moves if board.free.size else 0,
        (first_temperature * mean, last_temperature * mean),
        (first_weight * top, last_weight * top),
    )
    if not np.isfinite(cost):
        return None, float("inf")
    return unpad_layout(state.best, board.stride), float(cost)
