"""Fast feasible layouts: one run of simulated annealing, its inner loop compiled by numba.

Simulated annealing (Kirkpatrick, Gelatt and Vecchi 1983,
https://doi.org/10.1126/science.220.4598.671): a layout's energy is the cost of its changed cells
plus a penalty weight times the demands it breaks. That its driving area is one piece is no demand
but an invariant: moves that would break it are refused.
"""

from typing import NamedTuple

import numpy as np

from qdenv.native import formula, inlined, kernel
from qdenv.repair.anneal.connectivity import flip_driving, may_close
from qdenv.repair.anneal.energy import list_changed, put, remember, set_aisles, unmake, weigh
from qdenv.repair.anneal.moves import propose
from qdenv.repair.anneal.start import (
    compile_board,
    initial_aisles,
    initial_state,
    project,
    unpad_layout,
)
from qdenv.repair.anneal.state import (
    RISE_LIMITS,
    SIDES,
    WORDS,
    Aisles,
    Board,
    Move,
    Plan,
    State,
    Trait,
    no_move,
    random_u64,
    uniform_bits,
)
from qdenv.repair.rules import Facts, Progress, no_progress

_PERIODS = 1000  # times the schedule moves on in one run
_CHUNK = 2_000_000  # moves between two reports of progress, a fraction of a second
_LATE = 0.85  # share of the moves after which the penalty may be raised beyond its schedule
_PATIENCE = 50  # periods without a feasible layout before it is
_MAX_BOOST = 20.0
_BOOST_STEP = 1.05
_ACCEPT_BITS = (36, 10)  # of a move's second random word: one of the `RISE_LIMITS`


class Schedule(NamedTuple):
    """How a run cools down and grows strict."""

    temperatures: tuple[float, float]  # the first and the last, in units of the mean cost of a cell
    # the first and the last cost of a broken demand, in units of the largest cost of a cell
    penalty_weights: tuple[float, float]


# Chosen on published and random layouts of the paper's sizes: a last penalty weight of 1.5 and less
# left layouts infeasible.
LOW_PENALTY = Schedule((0.3, 0.1), (0.6, 2.2))
HIGH_PENALTY = Schedule((0.5, 0.1), (2.0, 8.0))
# No move may break a rule: from a start that obeys all of them, feasibility cannot be lost.
NO_VIOLATIONS = Schedule((0.3, 0.1), (20.0, 20.0))
# Mends the connections of an almost feasible layout; so cold that the rest stays as it is.
MENDING = Schedule((0.15, 0.1), (2.5, 2.5))


def anneal(
    layout: np.ndarray,
    facts: Facts,
    seed: int,
    moves: int,
    start: np.ndarray,
    schedule: Schedule = LOW_PENALTY,
    progress: Progress = no_progress,
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
        progress: called now and then with the share of the moves that is done.
        bound: no layout costs less: reaching it ends the run, and changes nothing else.

    Returns:
        The best feasible layout (int8 [H, W]) and its cost, or (None, inf).
    """
    board, rng = compile_board(layout, facts), np.random.default_rng(abs(seed))
    candidate, move = project(board, start, rng), no_move()
    aisles = initial_aisles(board, candidate, facts.rules.aisle)
    state = initial_state(board, candidate, aisles)
    costs, moves = board.change_cost[board.free], moves if board.free.size else 0
    mean, top = (float(costs.mean()), float(costs.max())) if costs.any() else (1.0, 1.0)
    (hot, cold), (light, heavy) = schedule
    period = max(moves // _PERIODS, 1)
    plan = Plan(
        seed=np.uint64(rng.integers(1 << 63)),
        moves=moves,
        period=period,
        periods=max(-(-moves // period), 1),
        temperatures=(hot * mean, cold * mean),
        penalty_weights=(light * top, heavy * top),
        enough=bound,
    )
    # In pieces, so that a long run can show how far it is.
    chunk = max(_CHUNK // plan.period, 1)
    for first in range(0, plan.periods, chunk):
        last = min(first + chunk, plan.periods)
        anneal_periods(board, state, aisles, move, plan, first, last)
        progress("annealing", last / plan.periods)
    if not np.isfinite(state.best_cost):
        return None, float("inf")
    best = unpad_layout(state.best, int(board.steps[4]))
    return best, facts.cost(best, layout)


@inlined
def _settle_driving(board: Board, state: State, move: Move, changes: int) -> bool:
    """Open and close what the move does; undone and refused if the driving area falls apart."""
    flipped, refused, drives = 0, False, board.traits[:, Trait.DRIVES]
    # Open before closing: a way round that the move itself opens counts.
    for opens in (1, 0):
        for index in range(changes):
            cell = move.cells[index]
            if drives[move.new[index]] != opens or drives[move.old[index]] == opens or refused:
                continue
            if board.connected:
                if opens:
                    refused = state.ring[cell] & SIDES == 0
                else:
                    refused = not may_close(board, state, cell)
            if not refused:
                flip_driving(board, state.ring, cell)
                flipped |= 1 << index
    if refused:
        for index in range(changes):
            if flipped >> index & 1:
                flip_driving(board, state.ring, move.cells[index])
    return not refused


@inlined
def _try_move(
    board: Board,
    state: State,
    aisles: Aisles | None,
    move: Move,
    changes: int,
    limit: float,
    penalty: float,
) -> bool:
    """Make the proposed move if its energy rises by at most `limit`; returns whether it did."""
    rise, breaks = weigh(board, state, move, changes)
    if aisles is not None:
        breaks += set_aisles(board, aisles, move.cells, move.new, changes)
    # The most expensive test comes last.
    accept = rise + penalty * breaks <= limit and _settle_driving(board, state, move, changes)
    if accept:
        put(board, state, move.cells[changes - 1], move.new[changes - 1])
        for index in range(changes):
            list_changed(board, state, move.cells[index])
        state.cost[()] += rise
        state.violations[()] += breaks
    else:
        unmake(board, state, move, changes)
        if aisles is not None:
            set_aisles(board, aisles, move.cells, move.old, changes)
    return accept


@formula
def _raise_penalty(state: State, done: float, period: int) -> float:
    """Raise the penalty when no feasible layout came by for 5 % of the moves.

    A demand may be worth more than the schedule pays, as where every shelf has four endpoints of
    its own. Earlier in the run violations are welcome: they are the way over the hills.
    """
    if done > _LATE and period - state.feasible_period[()] > _PATIENCE:
        state.boost[()] = min(_BOOST_STEP * state.boost[()], _MAX_BOOST)
    return state.boost[()]


@formula
def _note_feasible(state: State, period: int) -> None:
    """Keep the candidate if it breaks no rule and is cheaper than the best so far."""
    if state.violations[()] == 0:
        state.feasible_period[()] = period
        if state.cost[()] < state.best_cost[()]:
            state.best_cost[()] = state.cost[()]
            remember(state)


@kernel
def anneal_periods(
    board: Board,
    state: State,
    aisles: Aisles | None,
    move: Move,
    plan: Plan,
    first: int,
    last: int,
) -> None:
    """Anneal for the periods `first` to `last` - 1; where they are cut makes no difference.

    Ends early once nothing can be cheaper.

    The temperature falls geometrically; the penalty weight rises linearly, and faster while no
    feasible layout comes by. `state.best` receives the cheapest layout that broke nothing, and
    `state.best_cost` its cost.

    Args:
        board: the rules and the input.
        state: where to start; ends where the last move led.
        aisles: of `state`; None where rules allow narrow aisles.
        move: a buffer for one move.
        plan: how to draw and cool down.
        first: the first period.
        last: the one after the last.
    """
    (hot, cold), (light, heavy) = plan.temperatures, plan.penalty_weights
    for period in range(first, last):
        done = period / plan.periods
        temperature = hot * (cold / hot) ** done
        penalty = _raise_penalty(state, done, period) * (light + (heavy - light) * done)
        _note_feasible(state, period)
        # Only a cheaper layout would be kept: the moves saved change nothing.
        if state.best_cost[()] <= plan.enough:
            return
        for index in range(period * plan.period, min((period + 1) * plan.period, plan.moves)):
            changes = propose(board, state, move, plan.seed, WORDS * index)
            if changes == 0:
                continue
            source = random_u64(plan.seed, WORDS * index + 1)
            limit = temperature * RISE_LIMITS[uniform_bits(source, _ACCEPT_BITS)]
            if _try_move(board, state, aisles, move, changes, limit, penalty):
                _note_feasible(state, period)
