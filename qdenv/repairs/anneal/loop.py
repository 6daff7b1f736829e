"""Fast feasible layouts: one run of simulated annealing, its inner loop compiled by numba.

Simulated annealing (Kirkpatrick, Gelatt and Vecchi 1983,
https://doi.org/10.1126/science.220.4598.671): a layout's energy is the cost of its changed cells
plus a penalty weight times the demands it breaks. That its driving area is one piece is no demand
but an invariant: moves that would break it are refused.
"""

import numpy as np

from qdenv.native import formula, inlined, kernel
from qdenv.progress import Progress, silent
from qdenv.repairs.anneal.connectivity import may_close
from qdenv.repairs.anneal.covers import propose_rectangles, set_covers
from qdenv.repairs.anneal.moves import propose, put, weigh
from qdenv.repairs.anneal.start import compile_board, initial_covers, initial_state, project
from qdenv.repairs.anneal.state import (
    MOST,
    RISE_LIMITS,
    SIDES,
    WORDS,
    AnnealState,
    Board,
    Covers,
    Move,
    Schedule,
    Trait,
    random_u64,
    uniform_bits,
)
from qdenv.repairs.rules import Facts

_PERIODS = 1000  # times the schedule moves on in one run
_CHUNK = 2_000_000  # moves between two reports of progress, a fraction of a second
_LATE = 0.85  # share of the moves after which the penalty may be raised beyond its schedule
_PATIENCE = 50  # periods without a feasible layout before it is raised
_MAX_BOOST = 20.0  # factor on the penalty, at most
_BOOST_STEP = 1.05  # a period: a factor of 20 within 62 periods, fewer than are left
_ACCEPT_BITS = (36, 10)  # of a move's second random word: one of the `RISE_LIMITS`

# Temperatures in units of the mean cost of a cell, penalty weights in units of the largest. Chosen
# on published and random layouts of the paper's sizes: a last penalty weight of 1.5 and less left
# layouts infeasible.
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
    progress: Progress = silent,
    bound: float = -np.inf,
) -> tuple[np.ndarray | None, float]:
    """Find a cheap layout that obeys every rule, with a number of proposed moves.

    Changes are counted from the input `layout` (int8 [H, W]); `start` (int8 [H, W]) may be the
    input itself. The same seed gives the same layout. No layout costs less than `bound`: reaching
    it ends the run, and changes nothing else. Returns the best feasible layout (int8 [H, W]) and
    its cost, or (None, inf).
    """
    board, rng = compile_board(layout, facts), np.random.default_rng(abs(seed))
    projected = project(board, start, rng)
    covers = initial_covers(board, projected, facts)
    state = initial_state(board, projected, covers)
    costs, moves = board.change_cost[board.free], moves if board.free.size else 0
    mean, top = (float(costs.mean()), float(costs.max())) if costs.any() else (1.0, 1.0)
    (hot, cold), (light, heavy), *_ = schedule
    period, word = max(moves // _PERIODS, 1), np.uint64(rng.integers(1 << 63))
    periods = max(-(-moves // period), 1)
    temperatures, weights = (hot * mean, cold * mean), (light * top, heavy * top)
    run = Schedule(temperatures, weights, moves, period, periods, bound)
    # In pieces, so that a long run can show its progress.
    chunk, move = max(_CHUNK // period, 1), Move(*np.zeros((3, MOST), np.int64))
    for first in range(0, periods, chunk):
        last = min(first + chunk, periods)
        anneal_periods(board, state, covers, move, run, word, first, last)
        progress("annealing", last / periods, "")
    if not np.isfinite(state.best_cost):
        return None, float("inf")
    best = state.best.reshape(-1, layout.shape[1] + 2)[1:-1, 1:-1].copy()
    return best, facts.cost(best, layout)


@inlined
def _settle_driving(board: Board, state: AnnealState, move: Move, changes: int) -> bool:
    """Open and close what the move does; undone and refused if the driving area falls apart."""
    ring, steps, drives = state.ring, board.steps, board.traits[:, Trait.DRIVES]
    flipped, refused = 0, False
    # Open before closing: a way round that the move itself opens counts.
    for opens in (1, 0):
        for index in range(changes):
            cell = move.cells[index]
            if drives[move.new[index]] != opens or drives[move.old[index]] == opens or refused:
                continue
            if board.connected:
                refused = ring[cell] & SIDES == 0 if opens else not may_close(board, state, cell)
            if not refused:
                flipped |= 1 << index
                for place in range(8):  # a neighbour sees this cell at the opposite place
                    ring[cell + steps[place]] ^= 1 << (place + 4 & 7)
    for index in range(changes if refused else 0):
        if flipped >> index & 1:
            for place in range(8):
                ring[move.cells[index] + steps[place]] ^= 1 << (place + 4 & 7)
    return not refused


@inlined
def _try_move(
    board: Board,
    state: AnnealState,
    covers: Covers | None,
    move: Move,
    changes: int,
    limit: float,
    penalty: float,
) -> bool:
    """Make the proposed move if its energy rises by at most `limit`; returns whether it did."""
    rise, breaks = weigh(board, state, move, changes)
    hopeless = False
    if covers is not None:
        # At best the move mends all that is broken: most are refused without counting.
        hopeless = rise + penalty * (breaks - covers.broken[()]) > limit
        if not hopeless:
            breaks += set_covers(covers, move.cells, move.new, changes)
    # The most expensive test comes last.
    accept = not hopeless and rise + penalty * breaks <= limit
    accept = accept and _settle_driving(board, state, move, changes)
    if not accept:
        for index in range(changes - 1):  # the last change is not made yet
            put(board, state, move.cells[index], move.old[index])
        if covers is not None and not hopeless:
            set_covers(covers, move.cells, move.old, changes)
        return accept
    put(board, state, move.cells[changes - 1], move.new[changes - 1])
    changed, place, since = state.changed, state.place, state.since
    for index in range(changes):
        cell, count = move.cells[index], state.num_changed[()]
        differs = state.candidate[cell] != board.layout[cell]
        if differs and place[cell] == 0:
            changed[count] = cell
            place[cell] = count + 1
            state.num_changed[()] = count + 1
        elif not differs and place[cell] > 0:
            # The last cell of the list takes the place of the one that goes.
            last = changed[count - 1]
            changed[place[cell] - 1], place[last] = last, place[cell]
            place[cell] = 0
            state.num_changed[()] = count - 1
        if state.num_since[()] < since.size:
            since[state.num_since[()]] = cell
            state.num_since[()] += 1
    state.cost[()] += rise
    state.violations[()] += breaks
    return accept


@formula
def _note_feasible(state: AnnealState, period: int) -> None:
    """Keep the candidate if it breaks no rule and is cheaper than the best so far."""
    if state.violations[()] == 0:
        state.feasible_period[()] = period
        if state.cost[()] < state.best_cost[()]:
            state.best_cost[()] = state.cost[()]
            _remember(state)


@kernel
def _remember(state: AnnealState) -> None:
    """Copy the candidate to `best`; only what has changed since the last copy, if that is known."""
    if state.num_since[()] == state.since.size:
        for cell in range(state.candidate.size):
            state.best[cell] = state.candidate[cell]
    else:
        for entry in range(state.num_since[()]):
            state.best[state.since[entry]] = state.candidate[state.since[entry]]
    state.num_since[()] = 0


@kernel
def anneal_periods(
    board: Board,
    state: AnnealState,
    covers: Covers | None,
    move: Move,
    schedule: Schedule,
    seed: np.uint64,
    first: int,
    last: int,
) -> None:
    """Anneal for the periods `first` to `last` - 1; where they are cut makes no difference.

    The temperature falls geometrically; the penalty weight rises linearly, and faster while no
    feasible layout comes by. Ends early once nothing can be cheaper. `state` ends where the last
    move led; its `best` receives the cheapest layout that broke nothing, and `best_cost` its cost.
    `covers` are those of `state`, None where no rule is on rectangles; `move` is a buffer.
    """
    (hot, cold), (light, heavy) = schedule.temperatures, schedule.penalty_weights
    for period in range(first, last):
        done = period / schedule.periods
        temperature = hot * (cold / hot) ** done
        # A demand may be worth more than the schedule pays, as where every shelf has four endpoints
        # of its own: raise the penalty when no feasible layout came by for 5 % of the moves.
        # Earlier in the run violations are welcome: they are the way over the hills.
        if done > _LATE and period - state.feasible_period[()] > _PATIENCE:
            state.boost[()] = min(_BOOST_STEP * state.boost[()], _MAX_BOOST)
        penalty = state.boost[()] * (light + (heavy - light) * done)
        _note_feasible(state, period)
        # Only a cheaper layout would be kept: the moves saved change nothing.
        if state.best_cost[()] <= schedule.enough:
            return
        last_move = min((period + 1) * schedule.period, schedule.moves)
        for index in range(period * schedule.period, last_move):
            changes = -1
            if covers is not None:
                changes = propose_rectangles(board, state, covers, move, seed, WORDS * index)
            if changes < 0:
                changes = propose(board, state, move, seed, WORDS * index)
            if changes == 0:
                continue
            source = random_u64(seed, WORDS * index + 1)
            limit = temperature * RISE_LIMITS[uniform_bits(source, _ACCEPT_BITS)]
            if _try_move(board, state, covers, move, changes, limit, penalty):
                _note_feasible(state, period)
