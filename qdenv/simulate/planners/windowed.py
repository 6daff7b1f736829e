"""The windowed planner: prioritised planning in which agents bargain over who gives way.

A set of agents holds reservations that never conflict. Round after round, a few agents without a
reservation plan against it. A path may drive over reservations, at a penalty for each: if that is
cheaper than stepping aside, the path is taken and the owners lose their reservations and plan
again. The penalty grows with every attempt of an agent within the window. So at first everybody
asks for the shortest way, and then whoever can step aside most cheaply does: the parallel
counterpart of priority-based search choosing the cheaper child (RHCR, Li et al. 2021).

Agents left without a reservation after the last round fall back to a path from `last_resort`, as
do those in conflict with one that fell back. The last resort is a joint plan without conflicts,
so the outcome never has any.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp

from qdenv.simulate.planners import pibt, reservation, single_agent
from qdenv.simulate.planners.base import Problem, Situation, conflicts, first_of_each_clash
from qdenv.types import Array

NOBODY = -1


@dataclass(frozen=True)
class WindowedPlanner:
    """Plan windows by bargaining; every setting of the planner.

    Attributes:
        lanes: agents that plan side by side in one round.
        rounds: most rounds per agent-lane ratio, in units of ``agents / lanes``.
        layers: how finely driven-over reservations are counted (1 + the count told apart).
        penalties: timesteps an agent would rather lose than drive over one reservation, by attempt.
        last_resort: joint plan for agents that found no reservation.
        remember: let planners avoid, at no cost, where the others went in the last plan.
    """

    lanes: int = 16
    rounds: float = 4.0
    layers: int = 3
    penalties: tuple[float, ...] = (0.5, 1.5, 2.5, 4.5, 8.0, 16.0)
    last_resort: Callable[[Problem, Situation, int, Array], Array] = pibt.rollout
    remember: bool = True

    def __call__(self, problem: Problem, situation: Situation, horizon: int, key: Array) -> Array:
        """Plan a window for all agents (int32 [window + 1, A]); consumes the key."""
        bargain_key, resort_key = jax.random.split(key)
        book = bargain(self, problem, situation, horizon, bargain_key)
        return settle(self, problem, situation, horizon, book, resort_key)


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


def remember(book: Book, situation: Situation, shape: tuple[int, int], steps: int) -> Book:
    """Reserve the first steps of everybody's previous path until they plan themselves.

    They bind nobody, but tell whom to avoid where avoiding costs nothing.
    """
    time = jnp.arange(book.paths.shape[0])[:, None]
    live = (time <= steps) & situation.active
    place = jnp.where(live, situation.previous, book.owner.shape[1])
    agents = jnp.broadcast_to(jnp.arange(book.until.shape[0]), place.shape)
    return book._replace(
        table=reservation.reserve(book.table, situation.previous, live[1:], shape),
        owner=book.owner.at[time, place].set(agents, mode="drop"),
        paths=situation.previous,
        until=jnp.where(situation.active, steps, book.until),
    )


def look(problem: Problem, situation: Situation, table: Array, walls: Array, who: Array) -> dict:
    """Cut out what the agents `who` (int32 [K]) see around them (fields of a `View`)."""
    width = problem.traversable.shape[1]
    reach, side = single_agent.REACH, single_agent.SIDE
    position, slots, stay = situation.position[who], situation.goal[:, who], situation.stay[:, who]
    cells = problem.goals.cells[slots]
    row = cells // width - position // width + reach
    column = cells % width - position % width + reach
    ends = jnp.stack([jnp.ones_like(stay[0], bool), stay[1] > 0])
    seen = ends & (column >= 0) & (column < side) & (row >= 0) & (row < side)
    row, column = jnp.where(seen, row, 0), jnp.where(seen, column, 0)
    bit = jnp.where(seen, jnp.uint32(1) << column.astype(jnp.uint32), 0)
    goal = jnp.where(jnp.arange(side)[:, None] == row[:, None], bit[:, None], 0)
    step = jnp.arange(side) - reach
    cell = position + (step[:, None] * width + step)[:, :, None]
    cell = jnp.clip(cell, 0, problem.traversable.size - 1)
    flat = problem.distance.reshape(-1)
    size = problem.traversable.size
    to_go = flat[slots[:, None, None] * size + cell].astype(jnp.int32)
    between = problem.distance[slots[1], cells[0]].astype(jnp.int32)
    tail = single_agent.UNIT * (between + stay[1])
    price = single_agent.UNIT * (to_go + stay[:, None, None])
    price = price.at[0].add(tail)
    return {
        "taken": reservation.around(table, position, width, reach),
        "free": reservation.around(walls, position, width, reach),
        "goal": goal.astype(jnp.uint32),
        "goal_row": row,
        "goal_column": column,
        "price": price,
        "tail": tail,
        "stay": stay,
        "serving": situation.serving[who],
    }


def bargain(
    planner: WindowedPlanner, problem: Problem, situation: Situation, horizon: int, key: Array
) -> Book:
    """Run rounds of planning until everybody holds a reservation or the rounds are used up."""
    shape = problem.traversable.shape
    window = situation.previous.shape[0] - 1
    count = situation.position.shape[0]
    lanes = min(planner.lanes, count)
    order_key, noise_key = jax.random.split(key)
    luck = jax.random.uniform(order_key, (count,))
    # Agents that serve cannot give way: the others had better know of them first.
    turn = jnp.argsort(luck - (situation.serving > 0))
    order = jnp.zeros((count,), jnp.int32).at[turn].set(jnp.arange(count, dtype=jnp.int32))
    noise = jax.random.bits(noise_key, (count,), jnp.uint32).astype(jnp.int32) & 0xFFFFFF
    walls = reservation.pack(problem.traversable)
    penalties = jnp.array([round(single_agent.UNIT * p) for p in planner.penalties], jnp.int32)
    limit = int(planner.rounds * -(-count // lanes))
    first = jnp.broadcast_to(situation.position, situation.previous.shape)
    book = Book(
        table=reservation.empty(window, *shape),
        owner=jnp.full((window + 1, problem.traversable.size), NOBODY, jnp.int32),
        paths=first,
        until=jnp.where(situation.active, 0, window),
        attempts=jnp.zeros((count,), jnp.int32),
        rounds=jnp.int32(0),
    )

    if planner.remember:
        book = remember(book, situation, shape, window - horizon)

    def unfinished(book: Book) -> jax.Array:
        return (book.rounds < limit) & ~book.holds.all()

    def plan_round(book: Book) -> Book:
        urgency = book.attempts * count + order
        _, who = jax.lax.top_k(-jnp.where(book.holds, 2**30, urgency), lanes)
        asks = ~book.holds[who]
        if planner.remember:
            book = strike_out(book, shape, jnp.where(asks, who, count))
        penalty = penalties[jnp.minimum(book.attempts[who], len(planner.penalties) - 1)]
        table = book.table.reshape(window, reservation.PLANES, shape[0], -1)
        view = single_agent.View(
            **look(problem, situation, table, walls, who),
            penalty=penalty,
            noise=noise[who] ^ (book.rounds * 0x5851),
        )
        steps, price = single_agent.plan(view, planner.layers)
        paths = situation.position[who] + steps[0] * shape[1] + steps[1]
        able = asks & (price < single_agent.NEVER >> single_agent.CODE_BITS)
        accepted = first_of_each_clash(conflicts(paths, paths), able)
        return enter(book, shape, who, paths, accepted, asks)

    return jax.lax.while_loop(unfinished, plan_round, book)


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


def settle(
    planner: WindowedPlanner,
    problem: Problem,
    situation: Situation,
    horizon: int,
    book: Book,
    key: Array,
) -> jax.Array:
    """Give agents without a reservation the last resort, and everybody in their way too."""

    def fall_back(_: None) -> jax.Array:
        resort = planner.last_resort(problem, situation, horizon, key)
        clash = conflicts(book.paths[: horizon + 1], resort[: horizon + 1])
        clash = clash & ~jnp.eye(clash.shape[0], dtype=bool)
        clash = clash & situation.active[:, None] & situation.active[None, :]

        def spread(carry: tuple[Array, Array]) -> tuple[Array, Array]:
            falls, _ = carry
            more = falls | (clash & falls[None, :]).any(1)
            return more, (more != falls).any()

        falls, _ = jax.lax.while_loop(lambda c: c[1], spread, (~book.holds, jnp.bool_(True)))
        paths = jnp.where(falls, resort, book.paths)
        # Beyond the horizon the two kinds of path may conflict: forget that part.
        beyond = jnp.arange(paths.shape[0])[:, None] > horizon
        return jnp.where(beyond, paths[horizon], paths)

    return jax.lax.cond(book.holds.all(), lambda _: book.paths, fall_back, None)


LOW = WindowedPlanner(lanes=32, layers=2, rounds=3.0)
HIGH = WindowedPlanner()
EFFORTS = {"low": LOW, "high": HIGH}
