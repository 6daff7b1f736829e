"""The annealer's inner loop, compiled by numba and free of the interpreter lock.

Simulated annealing (Kirkpatrick, Gelatt and Vecchi 1983,
https://doi.org/10.1126/science.220.4598.671): a layout's energy is the cost of its changed cells
plus a penalty weight times the demands it breaks. That its driving area is one piece is no demand
but an invariant: moves that would break it are refused.
"""

import numpy as np

from qdenv.repair.anneal.connectivity import may_close, may_open
from qdenv.repair.anneal.energy import (
    apply_move,
    list_changed,
    open_and_close,
    set_driving_mask,
    undo_move,
)
from qdenv.repair.anneal.kernel import kernel
from qdenv.repair.anneal.moves import draw, propose
from qdenv.repair.anneal.state import Board, Column, Move, State

PERIODS = 1000  # times the schedule moves on in one run
LATE = 0.85  # share of the moves after which the penalty may be raised beyond its schedule
PATIENCE = 50  # periods without a feasible layout before it is
MAX_BOOST = 20.0
BOOST_STEP = 1.05
HOPELESS = 20.0  # slopes of so many temperatures are refused without a draw


@kernel
def _stays_connected(board: Board, state: State, move: Move, changes: int) -> bool:
    """Whether the move keeps the driving area in one piece; leaves the mask half changed."""
    driving, drives = state.driving, board.tile_table[:, Column.DRIVES]
    # Open before closing: a way round that the move itself opens counts.
    for index in range(changes):
        if drives[move.new[index]] and not driving[move.cells[index]]:
            if not may_open(driving, move.cells[index], board.stride):
                return False
            driving[move.cells[index]] = 1
    for index in range(changes):
        if driving[move.cells[index]] and not drives[move.new[index]]:
            if not may_close(board, driving, state.search, move.cells[index]):
                return False
            driving[move.cells[index]] = 0
    return True


@kernel
def _remember(state: State) -> None:
    """Keep the candidate as the best layout; cell by cell, as a slice would make an array."""
    for cell in range(state.candidate.size):
        state.best[cell] = state.candidate[cell]


@kernel
def _metropolis_accept(rng: np.ndarray, slope: float, temperature: float) -> bool:
    """Accept a rise in energy with probability exp(-slope / temperature); always a fall.

    Metropolis et al. 1953, https://doi.org/10.1063/1.1699114.
    """
    if slope <= 0:
        return True
    if slope >= HOPELESS * temperature:
        return False
    return draw(rng, 1 << 30) < np.exp(-(slope / temperature)) * (1 << 30)


@kernel
def _raise_penalty(penalty_boost: float, done: float, waited: int) -> float:
    """Raise the penalty when no feasible layout came by for 5 % of the moves.

    A demand may be worth more than the schedule pays, as where every shelf has four endpoints of
    its own. Earlier in the run breaches are welcome: they are the way over the hills.
    """
    if done > LATE and waited > PATIENCE:
        return min(BOOST_STEP * penalty_boost, MAX_BOOST)
    return penalty_boost


@kernel
def anneal_loop(
    board: Board,
    state: State,
    move: Move,
    rng: np.ndarray,
    moves: int,
    temperatures: tuple[float, float],
    penalty_weights: tuple[float, float],
) -> float:
    """Anneal for a fixed number of moves; returns the cost of the best feasible layout.

    The temperature falls geometrically; the penalty weight rises linearly, and faster while no
    feasible layout comes by. `state.best` receives the cheapest layout that broke nothing; the
    cost is infinite when there was none.

    Args:
        board: the rules and the input.
        state: where to start; ends where the last move led.
        move: room for one move.
        rng: uint64 [1], the state of `draw`, not 0.
        moves: proposed moves.
        temperatures: the first and the last.
        penalty_weights: the first and the last cost of a broken demand.
    """
    lowest, cost, broken = np.inf, state.cost, state.broken
    temperature, penalty_weight, penalty_boost = temperatures[0], penalty_weights[0], 1.0
    last_feasible, period = 0, max(moves // PERIODS, 1)
    for index in range(moves):
        if index % period == 0:
            done = index / moves
            penalty_boost = _raise_penalty(penalty_boost, done, (index - last_feasible) // period)
            temperature = temperatures[0] * (temperatures[1] / temperatures[0]) ** done
            planned = penalty_weights[0] + (penalty_weights[1] - penalty_weights[0]) * done
            penalty_weight = penalty_boost * planned
        if broken == 0:
            last_feasible = index
            if cost < lowest:
                lowest = cost
                _remember(state)
        changes = propose(board, state, move, rng)
        rise, breaks = apply_move(board, state, move, changes)
        # Aisles change with the driving mask; without them it waits for the cheaper tests.
        if board.aisle > 1:
            breaks += open_and_close(board, state, move.cells, move.new, changes)
        accept = _metropolis_accept(rng, rise + penalty_weight * breaks, temperature)
        # The dearest test comes last, and asks from the mask as it was before the move.
        if accept and board.connected:
            set_driving_mask(board, state, move.cells, move.old, changes)
            accept = _stays_connected(board, state, move, changes)
            set_driving_mask(board, state, move.cells, move.new, changes)
        if accept:
            cost += rise
            broken += breaks
            list_changed(board, state, move, changes)
        else:
            undo_move(board, state, move, changes)
        tiles = move.new if accept else move.old
        open_and_close(board, state, move.cells, tiles, changes)
    if broken == 0 and cost < lowest:
        lowest = cost
        _remember(state)
    return lowest
