"""One timestep of PIBT in compiled host code: agent by agent, as the algorithm is printed.

The rules are those of `rules`; the result is that of `xla.one_step`, bit for bit.
"""

import jax
import numpy as np
from jax.experimental.buffer_callback import buffer_callback

from qdenv.native import compiled
from qdenv.simulate.mapf.pibt import rules
from qdenv.simulate.mapf.planner import NOBODY


def one_step(
    candidates: jax.Array, position: jax.Array, allowed: jax.Array, order: jax.Array, cells: int
) -> jax.Array:
    """Do what `xla.one_step` does, in a callback that works on jax's own buffers."""

    def on_host(_: object, out: object, *arrays: object) -> None:
        # Only numpy here: a jax call inside a callback can wait for the very device it blocks.
        candidates, position, allowed, order = (np.asarray(array) for array in arrays)
        push_along(candidates, position, allowed, order, cells, np.asarray(out))

    shape = jax.ShapeDtypeStruct(position.shape, np.int32)
    call = buffer_callback(on_host, shape, vmap_method="sequential")
    return call(candidates, position, allowed, order)


@compiled
def push_along(
    candidates: np.ndarray,
    position: np.ndarray,
    allowed: np.ndarray,
    order: np.ndarray,
    cells: int,
    out: np.ndarray,
) -> None:
    """Move all agents by one step: the most urgent first, and whoever stands in the way before.

    The recursion of the paper is a chain that each agent leaves towards its pusher.

    Args:
        candidates: int32 [A, 5], as in `xla.one_step`.
        position: int32 [A].
        allowed: int32 [A].
        order: int32 [A].
        cells: number of cells.
        out: int32 [A], receives where the agents go.
    """
    count = position.size
    standing = np.full(cells, NOBODY, np.int32)
    claimant = np.full(cells, NOBODY, np.int32)
    tried = np.zeros(count, np.int32)
    pusher = np.full(count, NOBODY, np.int32)
    for agent in range(count):
        standing[position[agent]] = agent
    out[:] = NOBODY
    for first in order:
        agent = first if out[first] == NOBODY else NOBODY
        while agent != NOBODY:
            if tried[agent] >= allowed[agent]:  # nowhere to go: stay, and let the pusher try on
                out[agent] = position[agent]
                claimant[position[agent]] = agent
                agent = pusher[agent]
                continue
            cell = candidates[agent, tried[agent]]
            tried[agent] += 1
            other, behind = standing[cell], pusher[agent]
            other_next = out[other] if other != NOBODY else NOBODY
            pusher_position = position[behind] if behind != NOBODY else NOBODY
            if not rules.is_admissible(
                cell, position[agent], claimant[cell], other_next, pusher_position
            ):
                continue
            out[agent] = cell
            claimant[cell] = agent
            if rules.is_pushed(other, agent, other_next):
                pusher[other] = agent
                agent = other
            else:
                agent = NOBODY
