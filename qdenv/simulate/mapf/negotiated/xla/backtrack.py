"""Read a path backwards out of the sets of cells that could be reached."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from qdenv.simulate.mapf.negotiated.xla.window import CODE_BITS, View, clashes
from qdenv.types import Array


class Trail(NamedTuple):
    """Where the path is while it is read backwards, all int32 [K]; `elapsed` is -1 if driving."""

    level: Array
    layer: Array
    row: Array
    column: Array
    elapsed: Array


def decode(view: View, code: Array, layers: int) -> Trail:
    """Find the end of the path that `cheapest_end` chose."""
    cells = 2 * layers * view.side**2
    serving = code >= cells
    block = jnp.where(serving, (code - cells) // 32, code // view.side**2)
    level, layer = block // layers, block % layers
    lane = jnp.arange(code.shape[0])
    row = jnp.where(serving, view.goal_row[level, lane], code % view.side**2 // view.side)
    column = jnp.where(serving, view.goal_column[level, lane], code % view.side)
    return Trail(level, layer, row, column, jnp.where(serving, (code - cells) % 32, -1))


def step_back(
    view: View, trail: Trail, taken: Array, reached: Array, served: Array, now: Array
) -> Trail:
    """Go from one timestep to the one before.

    Args:
        view: what the agents see.
        trail: where the paths are at time t + 1.
        taken: uint32 [5, E, K], reservations between t and t + 1.
        reached: uint32 [layers, 2, E, K] at time t, where paths go on from.
        served: uint32 [layers, 2, K] at time t.
        now: the same at time t + 1.
    """
    lane = jnp.arange(trail.level.shape[0])
    layers = reached.shape[0]
    level, layer, row, column, elapsed = trail
    # Was the next goal's part of the path entered here, by finishing service at the current one?
    on_goal = (view.goal[0, row, lane] >> column.astype(jnp.uint32)) & 1 == 1
    finished = (now[layer, 0, lane] >> view.stay[0].astype(jnp.uint32)) & 1 == 1
    entered = (elapsed < 0) & (level == 1) & on_goal & finished
    level = jnp.where(entered, 0, level)
    elapsed = jnp.where(entered, view.stay[0], elapsed)

    def bit(words: Array, column: Array) -> jax.Array:
        inside = (column >= 0) & (column < view.side)
        return inside & ((words >> jnp.clip(column, 0, 31).astype(jnp.uint32)) & 1 == 1)

    fewer = jnp.maximum(layer - 1, 0)
    last = layer == layers - 1
    clash = [bit(word, column) for word in clashes(taken[:, row, lane])]

    # Serving: the layer falls where the stay was disturbed.
    held = elapsed > 0
    previous = jnp.maximum(elapsed - 1, 0).astype(jnp.uint32)
    from_fewer = (served[fewer, level, lane] >> previous) & 1 == 1
    held_layer = jnp.where(clash[0] & (layer > 0) & from_fewer, fewer, layer)

    # Driving: the first neighbour, in order of preference, from which this cell was reached.
    best_rank = jnp.full_like(level, 99)
    chosen = (row, column, layer)
    flip = (view.noise >> CODE_BITS) & 1
    for way, (down, right) in enumerate(((0, 0), (0, 1), (0, -1), (1, 0), (-1, 0))):
        i, j = row - down, column - right
        safe = jnp.clip(i, 0, view.side - 1)
        same = bit(reached[layer, level, safe, lane], j) & (i == safe)
        less = bit(reached[fewer, level, safe, lane], j) & (i == safe) & (layer > 0)
        ok = jnp.where(clash[way], less | (same & last), same)
        # Waiting first; then along the row or along the column, as the agent's noise says.
        rank = jnp.where(flip == 1, 5 - way, way) if way else 0
        better = ok & (rank < best_rank)
        best_rank = jnp.where(better, rank, best_rank)
        to_layer = jnp.where(clash[way] & less, fewer, layer)
        here = (i, j, to_layer)
        chosen = tuple(jnp.where(better, new, old) for new, old in zip(here, chosen, strict=True))
    return Trail(
        level,
        jnp.where(held, held_layer, chosen[2]),
        jnp.where(held, row, chosen[0]),
        jnp.where(held, column, chosen[1]),
        jnp.where(held, elapsed - 1, -1),
    )
