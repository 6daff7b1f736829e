"""Bargaining for a window in XLA, for accelerators: a few agents plan side by side in each round.

`host` does the same on one core of the host, with the same result to the bit.
"""

from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qdenv.simulate.mapf.negotiated.xla import bitplanes as reservation
from qdenv.simulate.mapf.negotiated.xla import search as single_agent
from qdenv.simulate.mapf.negotiated.xla.reservations import (
    Book,
    empty_book,
    enter,
    remember,
    strike_out,
)
from qdenv.simulate.mapf.negotiated.xla.window import CODE_BITS, NEVER, NOISE_STEP, UNIT, View
from qdenv.simulate.mapf.planner import AgentState, World, conflicts, first_of_each_clash
from qdenv.types import Array

if TYPE_CHECKING:
    from qdenv.simulate.mapf.negotiated.planner import WindowedPlanner


class PlanResult(NamedTuple):
    """What bargaining ends with.

    Attributes:
        paths: int32 [window + 1, A]. Those that are reserved never conflict.
        holds: bool [A], whose path is reserved; all padding agents count as such.
    """

    paths: Array
    holds: Array


class Lots(NamedTuple):
    """What chance decides.

    Attributes:
        order: int32 [A], who comes first among agents with equally many attempts.
        noise: int32 [A], 24 bits that settle ties between paths.
    """

    order: Array
    noise: Array


def draw_lots(state: AgentState, key: Array) -> Lots:
    """Draw the agents' order and the bits that settle ties; consumes the key."""
    order_key, noise_key = jax.random.split(key)
    count = state.position.shape[0]
    luck = jax.random.uniform(order_key, (count,))
    # Agents that serve cannot give way: the others had better know of them first.
    turn = jnp.argsort(luck - (state.remaining_service > 0))
    order = jnp.zeros((count,), jnp.int32).at[turn].set(jnp.arange(count, dtype=jnp.int32))
    noise = jax.random.bits(noise_key, (count,), jnp.uint32).astype(jnp.int32) & 0xFFFFFF
    return Lots(order, noise)


def quarter_steps(settings: "WindowedPlanner") -> np.ndarray:
    """Put the penalties in units of prices (int32 [attempts])."""
    return np.array([round(UNIT * penalty) for penalty in settings.penalties], np.int32)


def most_rounds(settings: "WindowedPlanner", state: AgentState) -> jax.Array:
    """Limit the rounds (int32). Padding takes no part: it must not change what others get."""
    lanes = min(settings.lanes, state.position.shape[0])
    crowd = -(-state.active.sum() // lanes)
    return (settings.rounds * crowd).astype(jnp.int32)


def bargain(
    settings: "WindowedPlanner", world: World, state: AgentState, horizon: int, key: Array
) -> PlanResult:
    """Run rounds of planning until everybody holds a reservation or the rounds are used up.

    Args:
        settings: of the planner.
        world: the layout.
        state: the agents; the length of its previous paths is the window.
        horizon: timesteps that will be driven.
        key: consumed.
    """
    shape = world.traversable.shape
    window = state.previous.shape[0] - 1
    count = state.position.shape[0]
    lanes = min(settings.lanes, count)
    lots = draw_lots(state, key)
    walls = reservation.pack(world.traversable)
    penalties = jnp.asarray(quarter_steps(settings))
    limit = most_rounds(settings, state)
    book = empty_book(state, shape)
    if settings.remember:
        book = remember(book, state, shape, window - horizon)

    def best_paths(book: Book, who: Array) -> tuple[Array, Array]:
        penalty = penalties[jnp.minimum(book.attempts[who], penalties.size - 1)]
        fields = look(world, state, book.table, walls, who, window)
        sight = View(**fields, penalty=penalty, noise=lots.noise[who] ^ (book.rounds * NOISE_STEP))
        steps, price = single_agent.plan(sight, settings.layers)
        able = price < NEVER >> CODE_BITS
        return state.position[who] + steps[0] * shape[1] + steps[1], able

    def unfinished(book: Book) -> jax.Array:
        return (book.rounds < limit) & ~book.holds.all()

    def plan_round(book: Book) -> Book:
        urgency = book.attempts * count + lots.order
        who = smallest(jnp.where(book.holds, 2**30, urgency), lanes)
        asks = ~book.holds[who]
        if settings.remember:
            book = strike_out(book, shape, jnp.where(asks, who, count))
        paths, able = best_paths(book, who)
        accepted = first_of_each_clash(conflicts(paths, paths), asks & able)
        return enter(book, shape, who, paths, accepted, asks)

    book = jax.lax.while_loop(unfinished, plan_round, book)
    return PlanResult(book.paths, book.holds)


def look(
    world: World, state: AgentState, table: Array, walls: Array, who: Array, reach: int
) -> dict:
    """Cut out what the agents `who` (int32 [K]) see around them (fields of a `View`)."""
    width = world.traversable.shape[1]
    side = 2 * reach + 1
    position, slots, stay = state.position[who], state.goal[:, who], state.service_time[:, who]
    cells = world.goals.cells[slots]
    row = cells // width - position // width + reach
    column = cells % width - position % width + reach
    ends = jnp.stack([jnp.ones_like(stay[0], bool), stay[1] > 0])
    seen = ends & (column >= 0) & (column < side) & (row >= 0) & (row < side)
    row, column = jnp.where(seen, row, 0), jnp.where(seen, column, 0)
    bit = jnp.where(seen, jnp.uint32(1) << column.astype(jnp.uint32), 0)
    goal = jnp.where(jnp.arange(side)[:, None] == row[:, None], bit[:, None], 0)
    shaped = table.reshape(-1, reservation.PLANES, *walls.shape)
    step = jnp.arange(side) - reach
    cell = position + (step[:, None] * width + step)[:, :, None]
    cell = jnp.clip(cell, 0, world.traversable.size - 1)
    flat = world.distance.reshape(-1)
    size = world.traversable.size
    to_go = flat[slots[:, None, None] * size + cell].astype(jnp.int32)
    between = world.distance[slots[1], cells[0]].astype(jnp.int32)
    tail = UNIT * (between + stay[1])
    price = UNIT * (to_go + stay[:, None, None])
    price = price.at[0].add(tail)
    return {
        "taken": reservation.around(shaped, position, width, reach),
        "free": reservation.around(walls, position, width, reach),
        "goal": goal.astype(jnp.uint32),
        "goal_row": row,
        "goal_column": column,
        "price": price,
        "tail": tail,
        "stay": stay,
        "serving": state.remaining_service[who],
    }


def smallest(keys: Array, count: int) -> jax.Array:
    """Find the indices of the `count` smallest keys (int32 [A]); a fifth of the time of top_k."""

    def take(keys: Array, _: None) -> tuple[Array, Array]:
        index = jnp.argmin(keys)
        return keys.at[index].set(jnp.iinfo(keys.dtype).max), index

    return jax.lax.scan(take, keys, None, length=count)[1]
