"""One timestep of PIBT on the host: `pibt.one_step`, agent by agent, bit for bit."""

from typing import Any

import jax
import numpy as np
from jax.experimental.buffer_callback import buffer_callback

from qdenv.native import compiled
from qdenv.simulate.mapf.negotiated.rules import NOBODY
from qdenv.types import Array


def one_step(
    candidates: Array, position: Array, allowed: Array, order: Array, cells: int
) -> jax.Array:
    """Do what `pibt.one_step` does, in a callback that works on jax's own buffers."""

    def on_host(_: Any, out: Any, *arrays: Any) -> None:
        push_along(*(np.asarray(array) for array in arrays), cells, np.asarray(out))

    shape = jax.ShapeDtypeStruct(position.shape, np.int32)
    call = buffer_callback(on_host, shape, vmap_method="sequential")
    return call(candidates, position, allowed, order)


@compiled
def push_along(candidates, position, allowed, order, cells, out):
    """Move all agents by one step: the most urgent first, and whoever stands in the way before.

    The arguments are those of `pibt.one_step`; `out` (int32 [A]) receives where the agents go.
    """
    count = position.size
    standing = np.full(cells, NOBODY, np.int32)
    claimed = np.zeros(cells, np.bool_)
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
                claimed[position[agent]] = True
                agent = pusher[agent]
                continue
            cell = candidates[agent, tried[agent]]
            tried[agent] += 1
            other, behind = standing[cell], pusher[agent]
            is_other = other != NOBODY and other != agent
            swap = is_other and out[other] == position[agent]
            back = behind != NOBODY and cell == position[behind]
            if claimed[cell] or swap or back:
                continue
            out[agent] = cell
            claimed[cell] = True
            if is_other and out[other] == NOBODY:
                pusher[other] = agent
                agent = other
            else:
                agent = NOBODY
