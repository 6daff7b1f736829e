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
    """Count the words of one row of `width` cells."""
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
    """Add (or with ``sign=-1`` remove) the reservations of some paths.

    Args:
        table: from `empty`.
        paths: int32 [window + 1, K], positions of the padded grid.
        mask: bool [K], which of them.
        shape: (H', W').
        sign: 1 or -1.
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
    """Cut the square of ``2 * reach + 1`` cells around every agent.

    Args:
        packed: uint32 [..., H', words].
        position: int32 [K].
        width: W'.
        reach: rows and columns to each side, at most 10.

    Returns:
        uint32 [..., 2 * reach + 1, K]: bit j of row i is the cell ``(i - reach, j - reach)`` away.
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


class Accepted(NamedTuple):
    """New paths that do not conflict with one another."""

    agent: jax.Array  # int32 [K]
    paths: jax.Array  # int32 [window + 1, K]
    mask: jax.Array  # bool [K], which of them count


def no_reservations(state: AgentState, shape: Shape) -> Reservations:
    """Begin without any; padding agents count as if they had their path."""
    window = state.previous.shape[0] - 1
    return Reservations(
        table=empty(window, *shape),
        owner=jnp.full((window + 1, shape[0] * shape[1]), NOBODY, jnp.int32),
        paths=jnp.broadcast_to(state.position, state.previous.shape),
        reserved_steps=jnp.where(state.active, 0, window),
    )


def remember(
    reservations: Reservations, state: AgentState, shape: Shape, steps: int
) -> Reservations:
    """Reserve the first steps of everybody's previous path until they plan themselves.

    They bind no agent, but tell whom to avoid where avoiding costs nothing.
    """
    count = state.position.shape[0]
    time = jnp.arange(state.previous.shape[0])[:, None]
    live = (time <= steps) & state.active
    place = jnp.where(live, state.previous, reservations.owner.shape[1])
    agents = jnp.broadcast_to(jnp.arange(count), place.shape)
    return Reservations(
        table=add_paths(reservations.table, state.previous, live[1:], shape),
        owner=reservations.owner.at[time, place].set(agents, mode="drop"),
        paths=state.previous,
        reserved_steps=jnp.where(state.active, steps, reservations.reserved_steps),
    )


def reserve(reservations: Reservations, shape: Shape, accepted: Accepted) -> Reservations:
    """Reserve accepted paths, which conflict with no reservation any more."""
    count, (agent, paths, mask) = reservations.reserved_steps.shape[0], accepted
    time = jnp.arange(paths.shape[0])[:, None]
    place = jnp.where(mask, paths, reservations.owner.shape[1])
    winners = jnp.where(mask, agent, count)
    owners = jnp.broadcast_to(agent, paths.shape)
    return Reservations(
        table=add_paths(reservations.table, paths, mask, shape),
        owner=reservations.owner.at[time, place].set(owners, mode="drop"),
        paths=reservations.paths.at[:, winners].set(paths, mode="drop"),
        reserved_steps=reservations.reserved_steps.at[winners].set(paths.shape[0] - 1, mode="drop"),
    )


def release(reservations: Reservations, shape: Shape, agents: jax.Array) -> Reservations:
    """Remove what some agents have reserved (int32 [K], A for nobody)."""
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


def evict(reservations: Reservations, shape: Shape, accepted: Accepted) -> Reservations:
    """Release the agents whose reservations accepted paths drive over, a few at a time."""
    count, lanes = reservations.reserved_steps.shape[0], accepted.agent.shape[0]

    def some(carry: tuple[Reservations, jax.Array]) -> tuple[Reservations, jax.Array]:
        reservations, losers = carry
        agents = jnp.nonzero(losers, size=lanes, fill_value=count)[0]
        return release(reservations, shape, agents), losers.at[agents].set(False, mode="drop")

    losers = _find_losers(reservations, accepted)
    return jax.lax.while_loop(lambda carry: carry[1].any(), some, (reservations, losers))[0]


def _find_losers(reservations: Reservations, accepted: Accepted) -> jax.Array:
    """Mark the agents whose reservations accepted paths drive over (bool [A])."""
    count, (_, paths, mask) = reservations.reserved_steps.shape[0], accepted
    time = jnp.arange(paths.shape[0])[:, None]
    met = reservations.owner[time[1:], paths[1:]]
    ahead = reservations.owner[time[:-1], paths[1:]]
    swapped = rules.is_swapped(ahead, reservations.owner[time[1:], paths[:-1]])
    losers = jnp.stack([met, jnp.where(swapped, ahead, NOBODY)])
    losers = jnp.where(mask & (losers != NOBODY), losers, count).reshape(-1)
    return jnp.zeros((count,), bool).at[losers].set(True, mode="drop")
