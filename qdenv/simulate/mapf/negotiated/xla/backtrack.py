"""Read a path backwards out of the sets of cells that could be reached."""

from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp

from qdenv.grid import NUM_MOVES
from qdenv.simulate.mapf.negotiated import path_rules, rules
from qdenv.simulate.mapf.negotiated.path_rules import PathState
from qdenv.simulate.mapf.negotiated.xla.observation import LocalWindow, conflicting_cells

PathStates: TypeAlias = PathState[jax.Array]  # of K paths


class History(NamedTuple):
    """What the search found, for the step from t to t + 1; over all steps with a leading axis."""

    reserved: jax.Array  # uint32 [5, E, K], reservations of the step (`bitplanes`)
    # uint32 [L, 2, E, K], cells that paths go on from at t, by conflicts and leg
    expandable: jax.Array
    served: jax.Array  # uint32 [L, 2, K], timesteps served at t
    served_after: jax.Array  # uint32 [L, 2, K], the same at t + 1


def end_state(local: LocalWindow, code: jax.Array, levels: int) -> PathStates:
    """Find the end of the path that the search chose."""
    state = path_rules.unpack_end(code, levels, local.side)
    agent = jnp.arange(code.shape[0])
    serving = state.elapsed >= 0
    return state._replace(
        row=jnp.where(serving, local.goal_row[state.leg, agent], state.row),
        column=jnp.where(serving, local.goal_column[state.leg, agent], state.column),
    )


def predecessor(local: LocalWindow, state: PathStates, step: History) -> PathStates:
    """Go from where the paths are at t + 1 to where they were at t."""
    agent = jnp.arange(state.leg.shape[0])
    service_time = local.service_time[0]
    on_first_goal = is_in(local.goal[0, state.row, agent], state.column, local.side)
    finished = rules.has_served(
        step.served_after[state.conflicts, 0, agent], service_time.astype(jnp.uint32)
    )
    entered = path_rules.is_entry(state, on_first_goal, finished == 1)
    state = state._replace(
        leg=jnp.where(entered, 0, state.leg),
        elapsed=jnp.where(entered, service_time, state.elapsed),
    )
    serving = state.elapsed > 0
    before = (serve_before(local, state, step), drive_before(local, state, step))
    return PathState(*(jnp.where(serving, one, other) for one, other in zip(*before, strict=True)))


def is_in(words: jax.Array, column: jax.Array, side: int) -> jax.Array:
    """Tell whether each word (uint32 [K]) has the bit of its column; none beyond the border."""
    inside = (column >= 0) & (column < side)
    return inside & ((words >> jnp.clip(column, 0, 31).astype(jnp.uint32)) & 1 == 1)


def serve_before(local: LocalWindow, state: PathStates, step: History) -> PathStates:
    """Serve for one timestep less."""
    agent = jnp.arange(state.leg.shape[0])
    fewer = jnp.maximum(state.conflicts - 1, 0)
    elapsed = jnp.maximum(state.elapsed - 1, 0).astype(jnp.uint32)
    conflict = path_rules.service_conflict(
        state.conflicts,
        is_in(step.reserved[0, state.row, agent], state.column, local.side),
        rules.has_served(step.served[fewer, state.leg, agent], elapsed) == 1,
    )
    return state._replace(conflicts=state.conflicts - conflict, elapsed=state.elapsed - 1)


def drive_before(local: LocalWindow, state: PathStates, step: History) -> PathStates:
    """Take the first neighbour, in order of preference, from which this cell was reached."""
    agent = jnp.arange(state.leg.shape[0])
    side, levels = local.side, step.expandable.shape[0]
    fewer = jnp.maximum(state.conflicts - 1, 0)
    at_cap = state.conflicts == levels - 1
    flipped = path_rules.is_flipped(local.noise)
    conflicts, row, column = state.conflicts, state.row, state.column
    best_rank = jnp.full_like(state.leg, NUM_MOVES)
    for move, words in enumerate(conflicting_cells(step.reserved[:, state.row, agent])):
        i, j = path_rules.row_before(state.row, move), path_rules.column_before(state.column, move)
        inside = jnp.clip(i, 0, side - 1)
        same = step.expandable[state.conflicts, state.leg, inside, agent]
        less = step.expandable[fewer, state.leg, inside, agent]
        from_same = is_in(same, j, side) & (i == inside)
        from_less = is_in(less, j, side) & (i == inside) & (state.conflicts > 0)
        conflicting = is_in(words, state.column, side)
        possible = path_rules.is_predecessor(from_same, from_less, conflicting, at_cap)
        rank = path_rules.move_at(move, flipped)  # its own inverse
        better = possible & (rank < best_rank)
        best_rank = jnp.where(better, rank, best_rank)
        conflicts = jnp.where(better, state.conflicts - (conflicting & from_less), conflicts)
        row, column = jnp.where(better, i, row), jnp.where(better, j, column)
    return PathState(state.leg, conflicts, row, column, jnp.full_like(state.elapsed, -1))
