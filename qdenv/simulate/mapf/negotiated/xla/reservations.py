"""The reservation table of a window: who holds which cells and moves, also packed in bits.

Five planes per timestep t of the window: plane 0 marks cells occupied at t + 1; planes 1 to 4 mark
cells that an agent leaves between t and t + 1 by a move to the right, left, down or up. An agent
that enters such a cell against the move would swap places, so the swap test is a bit test at the
cell entered. Rows of cells are cut into overlapping words: word j holds columns 11 j to 11 j + 31,
so that the 21 columns around any cell lie within a single word.

Reserved paths never conflict, hence every bit has one owner, and bits are set and cleared by adding
and subtracting words.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from qdenv.grid import NUM_MOVES
from qdenv.simulate.mapf.negotiated import rules
from qdenv.simulate.mapf.planner import NOBODY, AgentState

_STRIDE = 11  # columns between the starts of neighbouring words
_WORD = 32
_COPIES = 3  # words that hold one cell


def _words_per_row(width: int) -> int:
    """Return the number of words for a row of `width` cells."""
    return -(-width // _STRIDE)


def pack(mask: jax.Array) -> jax.Array:
    """Pack a map of cells (bool [H', W']) into overlapping words (uint32 [H', words])."""
    width = mask.shape[1]
    columns = _STRIDE * jnp.arange(_words_per_row(width))[:, None] + jnp.arange(_WORD)[None, :]
    bits = mask[:, jnp.minimum(columns, width - 1)] & (columns < width)[None]
    return (bits.astype(jnp.uint32) << jnp.arange(_WORD, dtype=jnp.uint32)).sum(
        -1, dtype=jnp.uint32
    )


def empty(window: int, rows: int, width: int) -> jax.Array:
    """Make a table without reservations (uint32 [window * 5 * H' * words], flat)."""
    return jnp.zeros((window * NUM_MOVES * rows * _words_per_row(width),), jnp.uint32)


def add_paths(
    table: jax.Array, paths: jax.Array, mask: jax.Array, shape: tuple[int, int], sign: int = 1
) -> jax.Array:
    """Add (or with ``sign=-1`` remove) the reservations of some paths to a table from `empty`.

    `paths` are positions of the padded grid (H', W') (int32 [window + 1, K]), `mask` says which of
    them count (bool [K], or [window, K] for single steps).
    """
    rows, width = shape
    words = _words_per_row(width)
    window = paths.shape[0] - 1
    plane = rules.move_plane(paths[1:] - paths[:-1], width)
    time = jnp.arange(window)[:, None]

    def updates(cells: jax.Array, plane: jax.Array, mask: jax.Array) -> tuple[jax.Array, jax.Array]:
        row, column = cells // width, cells % width
        base = ((time * NUM_MOVES + plane) * rows + row) * words
        places, values = [], []
        for copy in range(_COPIES):
            word = column // _STRIDE - copy
            bit = column - _STRIDE * word
            seen = mask & (word >= 0) & (bit < _WORD)
            places.append(base + jnp.maximum(word, 0))
            values.append(jnp.where(seen, jnp.uint32(1) << bit.astype(jnp.uint32) % _WORD, 0))
        return jnp.stack(places), jnp.stack(values)

    mask = jnp.broadcast_to(mask, plane.shape)
    entered = updates(paths[1:], jnp.zeros_like(plane), mask)
    left = updates(paths[:-1], plane, mask & (plane > 0))
    places = jnp.concatenate([entered[0].reshape(-1), left[0].reshape(-1)])
    values = jnp.concatenate([entered[1].reshape(-1), left[1].reshape(-1)]).astype(jnp.uint32)
    values = values if sign > 0 else -values
    return table.at[places].add(values, mode="promise_in_bounds")


def around(packed: jax.Array, position: jax.Array, width: int, reach: int) -> jax.Array:
    """Cut the square of ``2 * reach + 1`` cells around every agent (uint32 [..., side, K]).

    Bit j of row i is the cell ``(i - reach, j - reach)`` away from `position` (int32 [K]) in the
    words of a grid of `width` columns (uint32 [..., H', words]). A word holds a reach of 10.
    """
    words = _words_per_row(width)
    row, column = position // width, position % width - reach
    rows = row[None, :] - reach + jnp.arange(2 * reach + 1)[:, None]
    word, bit = column // _STRIDE, (column % _STRIDE).astype(jnp.uint32)
    flat = packed.reshape(*packed.shape[:-2], -1)
    seen = flat[..., rows * words + word[None, :]]
    return (seen >> bit) & jnp.uint32((1 << (2 * reach + 1)) - 1)


Shape = tuple[int, int]  # (H', W') of the padded grid


class Reservations(NamedTuple):
    """Who has reserved what."""

    table: jax.Array  # uint32, flat, the packed reservations, from `empty`
    owner: jax.Array  # int32 [window + 1, H' * W'], the agent at each cell and time, or `NOBODY`
    paths: jax.Array  # int32 [window + 1, A], the latest path of every agent
    reserved_steps: jax.Array  # int32 [A], steps of that path that are reserved

    @property
    def is_reserved(self) -> jax.Array:
        """Mark the agents whose whole path is reserved (bool [A])."""
        return self.reserved_steps == self.paths.shape[0] - 1


def begin(state: AgentState, shape: Shape, steps: int) -> Reservations:
    """Reserve the first steps of all previous paths until their agents plan.

    They bind no agent, but show whom to avoid where avoiding costs nothing. Padding agents count
    as if they had their path.
    """
    time = jnp.arange(state.previous.shape[0])[:, None]
    window, cells = state.previous.shape[0] - 1, shape[0] * shape[1]
    live = (time <= steps) & state.active
    place = jnp.where(live, state.previous, cells)
    agents = jnp.broadcast_to(jnp.arange(state.position.shape[0]), place.shape)
    owner = jnp.full((window + 1, cells), NOBODY, jnp.int32)
    return Reservations(
        table=add_paths(empty(window, *shape), state.previous, live[1:], shape),
        owner=owner.at[time, place].set(agents, mode="drop"),
        paths=state.previous,
        reserved_steps=jnp.where(state.active, steps, window),
    )


def release(reservations: Reservations, shape: Shape, agents: jax.Array) -> Reservations:
    """Remove what some agents have reserved (int32 [K], A for none)."""
    count = reservations.reserved_steps.shape[0]
    time = jnp.arange(reservations.paths.shape[0])[:, None]
    safe = jnp.minimum(agents, count - 1)
    paths = reservations.paths[:, safe]
    steps = jnp.where(agents < count, reservations.reserved_steps[safe], 0)
    place = jnp.where((time <= steps) & (steps > 0), paths, reservations.owner.shape[1])
    return reservations._replace(
        table=add_paths(reservations.table, paths, time[:-1] < steps, shape, sign=-1),
        owner=reservations.owner.at[time, place].set(NOBODY, mode="drop"),
        reserved_steps=reservations.reserved_steps.at[agents].set(0, mode="drop"),
    )


def accept(
    reservations: Reservations, shape: Shape, agent: jax.Array, paths: jax.Array, mask: jax.Array
) -> Reservations:
    """Reserve new paths and release the agents whose reservations they drive over.

    The paths (int32 [window + 1, K]) of `agent` (int32 [K]) do not conflict with one another;
    `mask` (bool [K]) says which of them count.
    """
    count, lanes = reservations.reserved_steps.shape[0], agent.shape[0]
    time, owner = jnp.arange(paths.shape[0])[:, None], reservations.owner
    met, ahead = owner[time[1:], paths[1:]], owner[time[:-1], paths[1:]]
    # A swap: the agent ahead before the step is behind after it.
    swapped = (ahead != NOBODY) & (owner[time[1:], paths[:-1]] == ahead)
    losers = jnp.stack([met, jnp.where(swapped, ahead, NOBODY)])
    losers = jnp.where(mask & (losers != NOBODY), losers, count).reshape(-1)
    losers = jnp.zeros((count,), bool).at[losers].set(True, mode="drop")

    def release_some(carry: tuple[Reservations, jax.Array]) -> tuple[Reservations, jax.Array]:
        reservations, losers = carry
        agents = jnp.nonzero(losers, size=lanes, fill_value=count)[0]
        return release(reservations, shape, agents), losers.at[agents].set(False, mode="drop")

    # All releases before all entries: a bit has one owner, so it must be free when it is set.
    taken = (reservations, losers)
    free, _ = jax.lax.while_loop(lambda carry: carry[1].any(), release_some, taken)
    place = jnp.where(mask, paths, owner.shape[1])
    winners = jnp.where(mask, agent, count)
    return Reservations(
        table=add_paths(free.table, paths, mask, shape),
        owner=free.owner.at[time, place].set(jnp.broadcast_to(agent, paths.shape), mode="drop"),
        paths=free.paths.at[:, winners].set(paths, mode="drop"),
        reserved_steps=free.reserved_steps.at[winners].set(paths.shape[0] - 1, mode="drop"),
    )
