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

from typing import NamedTuple

import jax
import jax.numpy as jnp

from qdenv.types import Array

REACH = 10  # most cells in sight to each side: the longest window
UNIT = 4  # prices are counted in quarters of a timestep
CODE_BITS = 12  # room for the end of a path: level, layer, row, column
NEVER = 2**30
LONGEST_STAY = 20  # elapsed service is one bit of a word, for a whole window longer


class View(NamedTuple):
    """What K agents see around them: squares of side E = 2 * reach + 1, at most 21.

    Attributes:
        taken: uint32 [window, 5, E, K], reserved cells and moves (`reservation`).
        free: uint32 [E, K], cells without walls.
        goal: uint32 [2, E, K], the current and the next goal, where they end a level.
        goal_row: int32 [2, K], their rows in sight (0 where out of sight).
        goal_column: int32 [2, K], likewise.
        price: int32 [2, E, E, K], quarter steps to go from each cell, per level.
        tail: int32 [K], quarter steps to go once the current goal is done.
        stay: int32 [2, K], timesteps to serve at each goal.
        serving: int32 [K], timesteps still to serve where the agent stands; 0 while driving.
        penalty: int32 [K], quarter steps per layer.
        noise: int32 [K], random bits that settle ties.
    """

    taken: Array
    free: Array
    goal: Array
    goal_row: Array
    goal_column: Array
    price: Array
    tail: Array
    stay: Array
    serving: Array
    penalty: Array
    noise: Array

    @property
    def side(self) -> int:
        """Rows and columns in sight (E)."""
        return self.free.shape[0]

    @property
    def middle(self) -> int:
        """Row and column of the agent itself."""
        return self.free.shape[0] // 2


class Front(NamedTuple):
    """What can be reached at one timestep; the axes are layer, level, row, agent.

    The order matters for speed: whole layers and rows move as blocks, agents lie side by side.

    Attributes:
        cells: uint32 [layers, 2, E, K], reached by driving, goals included.
        served: uint32 [layers, 2, K], bit e: serving for e timesteps.
        opened: uint32 [layers, 2, 1, K], all ones where a path may go on from the current goal:
            in level 1 when service there just ended.
    """

    cells: Array
    served: Array
    opened: Array


def next_layer(words: Array) -> jax.Array:
    """Move every layer (axis 0) to the next; the last one also keeps what it has."""
    if words.shape[0] == 1:
        return words
    return jnp.concatenate([jnp.zeros_like(words[:1]), words[:-2], words[-2:-1] | words[-1:]])


def clashes(taken: Array) -> tuple[jax.Array, ...]:
    """Mark where arriving would conflict: by waiting, moving right, left, down, up."""
    cell, right, left, down, up = (taken[plane] for plane in range(5))
    return cell, cell | left, cell | right, cell | up, cell | down


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
