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

import jax
import jax.numpy as jnp

from qdenv.simulate.planners import pibt, reservation, single_agent
from qdenv.simulate.planners.base import Problem, Situation, conflicts, first_of_each_clash
from qdenv.simulate.planners.book import Book, empty_book, enter, remember, strike_out
from qdenv.simulate.planners.view import CODE_BITS, NEVER, UNIT, View
from qdenv.types import Array, InputError


@dataclass(frozen=True)
class WindowedPlanner:
    """Plan windows by bargaining; every setting of the planner.

    Attributes:
        lookahead: timesteps planned without conflict, at most the simulation's window.
        lanes: agents that plan side by side in one round.
        rounds: most rounds per agent-lane ratio, in units of ``agents / lanes``.
        layers: how finely driven-over reservations are counted (1 + the count told apart).
        penalties: timesteps an agent would rather lose than drive over one reservation, by attempt.
        last_resort: joint plan for agents that found no reservation.
        remember: let planners avoid, at no cost, where the others went in the last plan.
    """

    lookahead: int = 10
    lanes: int = 16
    rounds: float = 4.0
    layers: int = 3
    penalties: tuple[float, ...] = (0.5, 1.5, 2.5, 4.5, 8.0, 16.0)
    last_resort: Callable[[Problem, Situation, int, Array], Array] = pibt.rollout
    remember: bool = True

    def __post_init__(self) -> None:
        """Refuse layers whose counts would overflow a path's price."""
        if not 1 <= self.layers <= 4:
            raise InputError(f"a windowed planner tells 1 to 4 layers apart, not {self.layers}")

    def __call__(self, problem: Problem, situation: Situation, horizon: int, key: Array) -> Array:
        """Plan a window for all agents (int32 [window + 1, A]); consumes the key."""
        bargain_key, resort_key = jax.random.split(key)
        window = situation.previous.shape[0] - 1
        ahead = max(horizon, min(self.lookahead, window))
        near = situation._replace(previous=situation.previous[: ahead + 1])
        book = bargain(self, problem, near, horizon, bargain_key)
        paths = settle(self, problem, near, horizon, book, resort_key)
        rest = jnp.broadcast_to(paths[-1], (window - ahead, paths.shape[1]))
        return jnp.concatenate([paths, rest])


def look(
    problem: Problem, situation: Situation, table: Array, walls: Array, who: Array, reach: int
) -> dict:
    """Cut out what the agents `who` (int32 [K]) see around them (fields of a `View`)."""
    width = problem.traversable.shape[1]
    side = 2 * reach + 1
    position, slots, stay = situation.position[who], situation.goal[:, who], situation.stay[:, who]
    cells = problem.goals.cells[slots]
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
    cell = jnp.clip(cell, 0, problem.traversable.size - 1)
    flat = problem.distance.reshape(-1)
    size = problem.traversable.size
    to_go = flat[slots[:, None, None] * size + cell].astype(jnp.int32)
    between = problem.distance[slots[1], cells[0]].astype(jnp.int32)
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
        "serving": situation.serving[who],
    }


def bargain(
    planner: WindowedPlanner, problem: Problem, situation: Situation, horizon: int, key: Array
) -> Book:
    """Run rounds of planning until everybody holds a reservation or the rounds are used up."""
    shape = problem.traversable.shape
    window = situation.previous.shape[0] - 1
    reach = window  # nobody gets farther
    count = situation.position.shape[0]
    lanes = min(planner.lanes, count)
    order_key, noise_key = jax.random.split(key)
    luck = jax.random.uniform(order_key, (count,))
    # Agents that serve cannot give way: the others had better know of them first.
    turn = jnp.argsort(luck - (situation.serving > 0))
    order = jnp.zeros((count,), jnp.int32).at[turn].set(jnp.arange(count, dtype=jnp.int32))
    noise = jax.random.bits(noise_key, (count,), jnp.uint32).astype(jnp.int32) & 0xFFFFFF
    walls = reservation.pack(problem.traversable)
    penalties = jnp.array([round(UNIT * p) for p in planner.penalties], jnp.int32)
    # Padding takes no part, so that a sweep gives each number of agents what it would get alone.
    crowd = -(-situation.active.sum() // lanes)
    limit = (planner.rounds * crowd).astype(jnp.int32)
    book = empty_book(situation, shape)
    if planner.remember:
        book = remember(book, situation, shape, window - horizon)

    def best_paths(book: Book, who: Array) -> tuple[Array, Array]:
        penalty = penalties[jnp.minimum(book.attempts[who], len(planner.penalties) - 1)]
        fields = look(problem, situation, book.table, walls, who, reach)
        luck = noise[who] ^ (book.rounds * 0x5851)
        sight = View(**fields, penalty=penalty, noise=luck)
        steps, price = single_agent.plan(sight, planner.layers)
        able = price < NEVER >> CODE_BITS
        return situation.position[who] + steps[0] * shape[1] + steps[1], able

    def unfinished(book: Book) -> jax.Array:
        return (book.rounds < limit) & ~book.holds.all()

    def plan_round(book: Book) -> Book:
        urgency = book.attempts * count + order
        who = smallest(jnp.where(book.holds, 2**30, urgency), lanes)
        asks = ~book.holds[who]
        if planner.remember:
            book = strike_out(book, shape, jnp.where(asks, who, count))
        paths, able = best_paths(book, who)
        accepted = first_of_each_clash(conflicts(paths, paths), asks & able)
        return enter(book, shape, who, paths, accepted, asks)

    return jax.lax.while_loop(unfinished, plan_round, book)


def smallest(keys: Array, count: int) -> jax.Array:
    """Find the indices of the `count` smallest keys (int32 [A]); a fifth of the time of top_k."""

    def take(keys: Array, _: None) -> tuple[Array, Array]:
        index = jnp.argmin(keys)
        return keys.at[index].set(jnp.iinfo(keys.dtype).max), index

    return jax.lax.scan(take, keys, None, length=count)[1]


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


# Low for the inside of a search; medium for big fleets and many seeds; high for reported numbers:
# fewer agents a round and a finer ladder of penalties cost three times medium's time and bring
# 1 to 2 % more throughput at hot spots.
LOW = WindowedPlanner(lookahead=7, penalties=(0.5, 2.5, 8.0, 16.0), rounds=3.0)
MEDIUM = WindowedPlanner()
HIGH = WindowedPlanner(
    lanes=8,
    rounds=12.0,
    layers=4,
    penalties=(0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.5, 5.5, 6.5, 8.5, 11.0, 16.0),
)
EFFORTS = {"low": LOW, "medium": MEDIUM, "high": HIGH}
