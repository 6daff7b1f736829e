"""The best path of one agent through a window, given what the others have reserved.

Every set of cells is a square of bits around the agent, one word per row. Which cells can be
reached at time t + 1 follows from those at time t by shifting words. The sets are kept apart by

    level  0 on the way to the current goal, 1 on the way to the next one;
    layer  how many reservations were driven over so far: 0, 1, ..., and the last layer for more.

Only the end of a path has a price: the steps still to go from there, plus a penalty per layer. The
path itself is read off backwards by asking which neighbour was reachable one step before. Going
back it prefers to wait, so the path drives early and waits late.

While an agent serves at a goal it is in no set; bit e of `served` says that a path exists by which
it has been serving for e timesteps.
"""

import jax
import jax.numpy as jnp

from qdenv.simulate.mapf.negotiated.xla.backtrack import Trail, decode, step_back
from qdenv.simulate.mapf.negotiated.xla.window import CODE_BITS, NEVER, UNIT, Front, View, clashes
from qdenv.types import Array


def next_layer(words: Array) -> jax.Array:
    """Move every layer (axis 0) to the next; the last one also keeps what it has."""
    if words.shape[0] == 1:
        return words
    return jnp.concatenate([jnp.zeros_like(words[:1]), words[:-2], words[-2:-1] | words[-1:]])


def departures(view: View, front: Front) -> jax.Array:
    """List where paths go on from: goals are left only after service, and in the next level."""
    return (front.cells & ~view.goal) | (front.opened & view.goal[:1])


def serve(view: View, cells: Array, served: Array, disturbed: Array) -> Front:
    """Let the agents at their goals begin, go on or end their service.

    Args:
        view: what the agents see.
        cells: uint32 [layers, 2, E, K], cells just reached.
        served: uint32 [layers, 2, K], service until one timestep ago.
        disturbed: bool [2, K], another agent has reserved the goal now.
    """
    layers, count = cells.shape[0], cells.shape[-1]
    longer = served << 1
    served = jnp.where(disturbed, 0, longer) | next_layer(jnp.where(disturbed, longer, 0))
    layer, level, lane = jnp.ogrid[:layers, :2, :count]
    goal_row = cells[layer, level, view.goal_row, lane] & view.goal[level, view.goal_row, lane]
    served = served | ((goal_row >> view.goal_column.astype(jnp.uint32)) & 1)
    done = (served[:, 0] >> view.stay[0].astype(jnp.uint32)) & 1
    opened = jnp.stack([jnp.zeros_like(done), -done], axis=1)[:, :, None]
    return Front(cells, served, opened)


def advance(view: View, front: Front, taken: Array, disturbed: Array) -> Front:
    """Take one timestep past the reservations `taken` (uint32 [5, E, K])."""
    here = departures(view, front)
    edge = jnp.zeros_like(here[:, :, :1])
    down = jnp.concatenate([edge, here[:, :, :-1]], axis=2)
    up = jnp.concatenate([here[:, :, 1:], edge], axis=2)
    clean = dirty = jnp.zeros_like(here)
    for move, clash in zip((here, here << 1, here >> 1, down, up), clashes(taken), strict=True):
        clean = clean | (move & view.free & ~clash)
        dirty = dirty | (move & view.free & clash)
    return serve(view, clean | next_layer(dirty), front.served, disturbed)


def start(view: View, layers: int) -> Front:
    """Set what is reached before the first step: the middle, or the service under way."""
    count = view.penalty.shape[0]
    driving = view.serving == 0
    middle = jnp.where(driving, jnp.uint32(1 << view.middle), 0)
    elapsed = (view.stay[0] - view.serving).astype(jnp.uint32)
    cells = jnp.zeros((layers, 2, view.side, count), jnp.uint32).at[0, 0, view.middle].set(middle)
    served = jnp.zeros((layers, 2, count), jnp.uint32)
    served = served.at[0, 0].set(jnp.where(driving, 0, jnp.uint32(1) << elapsed))
    # Standing on the goal is not arriving: the path leaves it like any other cell.
    on_goal = driving & ((view.goal[0, view.middle] >> view.middle) & 1 == 1)
    opened = jnp.zeros((layers, 2, 1, count), jnp.uint32)
    opened = opened.at[0, 0, 0].set(jnp.where(on_goal, jnp.uint32((1 << view.side) - 1), 0))
    return Front(cells, served, opened)


def cheapest_end(view: View, reached: Array, served: Array) -> tuple[Array, Array]:
    """Choose where to be after the window (price, code), both int32 [K]."""
    layers, count = reached.shape[0], reached.shape[-1]
    column = jnp.arange(view.side, dtype=jnp.uint32)[:, None]
    noise = view.noise & ((1 << CODE_BITS) - 1)
    best = jnp.full((count,), NEVER, jnp.int32)
    for level in range(2):
        for layer in range(layers):
            block = level * layers + layer
            code = block * view.side**2 + jnp.arange(view.side**2).reshape(view.side, view.side, 1)
            here = (reached[layer, level][:, None] >> column) & 1
            price = view.price[level] + layer * view.penalty
            key = jnp.where(here == 1, (price << CODE_BITS) | (code ^ noise), NEVER)
            best = jnp.minimum(best, key.min((0, 1)))
            best = jnp.minimum(best, serving_end(view, served, level, layer, noise))
    return best >> CODE_BITS, jnp.where(best < NEVER, (best ^ noise) & ((1 << CODE_BITS) - 1), 0)


def serving_end(view: View, served: Array, level: int, layer: int, noise: Array) -> jax.Array:
    """Find the cheapest way to end the window while serving (key int32 [K])."""
    layers = served.shape[0]
    elapsed = jnp.arange(32)[:, None]
    code = 2 * layers * view.side**2 + (level * layers + layer) * 32 + elapsed
    here = (served[layer, level] >> elapsed.astype(jnp.uint32)) & 1
    todo = UNIT * jnp.maximum(view.stay[level] - elapsed, 0)
    price = todo + (1 - level) * view.tail + layer * view.penalty
    return jnp.where(here == 1, (price << CODE_BITS) | (code ^ noise), NEVER).min(0)


def plan(view: View, layers: int) -> tuple[jax.Array, jax.Array]:
    """Find the best path of every agent in `view`.

    Args:
        view: what K agents see.
        layers: how finely conflicts are counted; 1 for not at all.

    Returns:
        rows and columns relative to the start, int32 [2, window + 1, K], and the price int32 [K]
        in quarter steps from the end of the window on (`NEVER` where nothing can be reached).
    """
    lane = jnp.arange(view.penalty.shape[0])
    level = jnp.arange(2)[:, None]
    on_goal = view.taken[:, 0][:, view.goal_row, lane] & view.goal[level, view.goal_row, lane]
    disturbed = on_goal != 0

    def step(front: Front, inputs: tuple[Array, Array]) -> tuple[Front, tuple[Array, Array]]:
        return advance(view, front, *inputs), (departures(view, front), front.served)

    front, history = jax.lax.scan(step, start(view, layers), (view.taken, disturbed))
    price, code = cheapest_end(view, departures(view, front), front.served)
    now = jnp.concatenate([history[1][1:], front.served[None]])

    def back(trail: Trail, inputs: tuple) -> tuple[Trail, Array]:
        return step_back(view, trail, *inputs), jnp.stack([trail.row, trail.column])

    trail = decode(view, code, layers)
    first, cells = jax.lax.scan(back, trail, (view.taken, *history, now), reverse=True)
    begin = jnp.stack([first.row, first.column])
    return jnp.concatenate([begin[None], cells]).swapaxes(0, 1) - view.middle, price
