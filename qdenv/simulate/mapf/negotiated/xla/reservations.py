"""The book of a window: who has reserved which cells and moves, entered and struck out."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from qdenv.simulate.mapf.negotiated.xla import bitplanes as reservation
from qdenv.simulate.mapf.planner import AgentState
from qdenv.types import Array

NOBODY = -1


class Book(NamedTuple):
    """Who has reserved what.

    Attributes:
        table: the packed reservations.
        owner: int32 [window + 1, H' * W'], the agent at each cell and time, or `NOBODY`.
        paths: int32 [window + 1, A], the latest path of every agent.
        until: int32 [A], timesteps of the path that are reserved.
        attempts: int32 [A], how often the agent planned in this window.
        rounds: int32, rounds so far.
    """

    table: Array
    owner: Array
    paths: Array
    until: Array
    attempts: Array
    rounds: Array

    @property
    def holds(self) -> Array:
        """Mark the agents whose whole path is reserved (bool [A])."""
        return self.until == self.paths.shape[0] - 1


def empty_book(state: AgentState, shape: tuple[int, int]) -> Book:
    """Open a book for a grid of `shape` (H', W')."""
    window, count = state.previous.shape[0] - 1, state.position.shape[0]
    return Book(
        table=reservation.empty(window, *shape),
        owner=jnp.full((window + 1, shape[0] * shape[1]), NOBODY, jnp.int32),
        paths=jnp.broadcast_to(state.position, state.previous.shape),
        until=jnp.where(state.active, 0, window),
        attempts=jnp.zeros((count,), jnp.int32),
        rounds=jnp.int32(0),
    )


def remember(book: Book, state: AgentState, shape: tuple[int, int], steps: int) -> Book:
    """Reserve the first steps of everybody's previous path until they plan themselves.

    They bind nobody, but tell whom to avoid where avoiding costs nothing.
    """
    time = jnp.arange(book.paths.shape[0])[:, None]
    live = (time <= steps) & state.active
    place = jnp.where(live, state.previous, book.owner.shape[1])
    agents = jnp.broadcast_to(jnp.arange(book.until.shape[0]), place.shape)
    return book._replace(
        table=reservation.reserve(book.table, state.previous, live[1:], shape),
        owner=book.owner.at[time, place].set(agents, mode="drop"),
        paths=state.previous,
        until=jnp.where(state.active, steps, book.until),
    )


def enter(
    book: Book, shape: tuple[int, int], who: Array, paths: Array, accepted: Array, asks: Array
) -> Book:
    """Write accepted paths into the book and strike out whatever they drive over."""
    count = book.holds.shape[0]
    time = jnp.arange(paths.shape[0])[:, None]
    met = book.owner[time[1:], paths[1:]]
    there = book.owner[time[:-1], paths[1:]]
    swapped = (there != NOBODY) & (book.owner[time[1:], paths[:-1]] == there)
    losers = jnp.stack([met, jnp.where(swapped, there, NOBODY)])
    losers = jnp.where(accepted & (losers != NOBODY), losers, count).reshape(-1)
    evicted = jnp.zeros((count,), bool).at[losers].set(True, mode="drop")

    book = strike_out_all(book, shape, evicted, who.shape[0])
    place = jnp.where(accepted, paths, book.owner.shape[1])
    winners = jnp.where(accepted, who, count)
    return Book(
        table=reservation.reserve(book.table, paths, accepted, shape),
        owner=book.owner.at[time, place].set(jnp.broadcast_to(who, paths.shape), mode="drop"),
        paths=book.paths.at[:, winners].set(paths, mode="drop"),
        until=book.until.at[winners].set(paths.shape[0] - 1, mode="drop"),
        attempts=book.attempts.at[jnp.where(asks, who, count)].add(1, mode="drop"),
        rounds=book.rounds + 1,
    )


def strike_out(book: Book, shape: tuple[int, int], who: Array) -> Book:
    """Remove what the agents `who` (int32 [K], A for nobody) have reserved."""
    count = book.until.shape[0]
    time = jnp.arange(book.paths.shape[0])[:, None]
    safe = jnp.minimum(who, count - 1)
    paths, until = book.paths[:, safe], jnp.where(who < count, book.until[safe], 0)
    place = jnp.where((time <= until) & (until > 0), paths, book.owner.shape[1])
    return book._replace(
        table=reservation.reserve(book.table, paths, time[:-1] < until, shape, sign=-1),
        owner=book.owner.at[time, place].set(NOBODY, mode="drop"),
        until=book.until.at[who].set(0, mode="drop"),
    )


def strike_out_all(book: Book, shape: tuple[int, int], evicted: Array, lanes: int) -> Book:
    """Remove the evicted agents (bool [A]) from the book, a few at a time."""
    count = evicted.shape[0]

    def some(carry: tuple[Book, Array]) -> tuple[Book, Array]:
        book, evicted = carry
        who = jnp.nonzero(evicted, size=lanes, fill_value=count)[0]
        return strike_out(book, shape, who), evicted.at[who].set(False, mode="drop")

    return jax.lax.while_loop(lambda carry: carry[1].any(), some, (book, evicted))[0]
