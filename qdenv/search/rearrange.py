"""An evolution strategy that rearranges a plan: children are parents, parts of which are moved.

For the generator `direct`, whose solutions are tiles. A child differs from its parent by a few
changes: the tiles of a rectangle move on by some cells, those that leave it at one side come back
at the other, so that racks and aisles move as wholes; or a rectangle is drawn once more elsewhere;
or two cells trade places. What is held is the *repaired* child, from which the next one differs
little: repairs of drawings that differ more and more would wander.

Simulations are noisy, and the best of many was lucky. So every member of the population is
evaluated again in each iteration, and ranked by its mean less its standard error.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qdenv.search.base import (
    Algorithm,
    Problem,
    SearchState,
    StoredArchive,
    check_batch,
    plain_key,
    start_solution,
)
from qdenv.search.settings import RearrangeConfig
from qdenv.types import Array, Extras, InputError, Score

_MOST_CHANGES = 4  # of one child; half of the children have one, a quarter two
_PROVEN = 3  # evaluations of a member after which it enters the archive, with their mean
_MEMORY = 0.9  # share of the old estimate of the noise that the next one keeps


class Population(NamedTuple):
    """Layouts that are evaluated again and again."""

    tiles: jax.Array  # float [N, P]
    total: jax.Array  # float [N], sum of the objectives of each one's evaluations
    times: jax.Array  # int32 [N], how many those are; 0 where there is no member
    noise: jax.Array  # float, variance of an evaluation


def rearrange(config: RearrangeConfig, problem: Problem, x0: Array | None = None) -> Algorithm:
    """Make the search around a plan, that of the problem's encoding or `x0` (float [P]).

    Layouts beyond the axes of the archive count as failed. Raises InputError if solutions are no
    tiles, or there is no plan.
    """
    encoding, members = problem.encoding, min(config.population, config.batch - 1)
    if encoding is None or not encoding.choices or members < 1:
        raise InputError("rearrange moves tiles: give --generator direct and --batch 2 or more")
    top, left = encoding.margin
    shape = encoding.shape[0] - 2 * top, encoding.shape[1] - 2 * left

    def inside(layouts: Array) -> jax.Array:
        """Read the solutions of framed layouts (int8 [B, H, W] -> float [B, P])."""
        drawn = jnp.asarray(layouts)[:, top : top + shape[0], left : left + shape[1]]
        return drawn.reshape(len(drawn), -1).astype(float)

    if x0 is None and encoding.around is None:
        raise InputError("rearrange goes around a plan: use qdenv improve")
    x0 = inside(np.asarray(encoding.around)[None])[0] if x0 is None else x0
    start, choices = start_solution(x0, problem.solution_dim), encoding.choices
    odds = jnp.array([config.shifts, config.copies, max(1 - config.shifts - config.copies, 0)])

    def init(key: jax.Array) -> SearchState:
        nothing = jnp.zeros(members, start.dtype)
        tiles, count = jnp.tile(start, (members, 1)), jnp.zeros(members, jnp.int32)
        population = Population(tiles, nothing, count, nothing[0])
        archives = StoredArchive.empty(problem, start, members)
        return SearchState(plain_key(key), population, archives)

    def ask(state: SearchState) -> tuple[jax.Array, SearchState]:
        key, parent_key, child_key = jax.random.split(state.key, 3)
        own, children = state.emitters, config.batch - members
        chances = jnp.where((own.times > 0) | (own.times.sum() == 0), 0.0, -jnp.inf)
        parents = own.tiles[jax.random.categorical(parent_key, chances, shape=(children,))]
        tiles = parents.reshape(-1, *shape).astype(jnp.int32)
        keys = jax.random.split(child_key, children)
        drawn = jax.vmap(lambda key, parent: changed(key, parent, choices, odds))(keys, tiles)
        drawn = drawn.reshape(children, -1).astype(start.dtype)
        return jnp.concatenate([own.tiles, drawn]), state._replace(key=key)

    def tell(state: SearchState, solutions: Array, score: Score, extras: Extras) -> SearchState:
        held, score = check_batch(inside(extras["repaired"]), score)
        low = jnp.array([[axis.low for axis in problem.measures]])
        high = jnp.array([[axis.high for axis in problem.measures]])
        within = ((score.measures >= low) & (score.measures < high)).all(axis=-1)
        score = score._replace(success=score.success & within)
        own, after = _selected(state.emitters, held, score)
        proven = score.success[:members] & (own.times >= _PROVEN)
        first = Score(*(column[:members] for column in score))._replace(success=proven)
        mean = own.total / jnp.maximum(own.times, 1)
        first = first._replace(objective=mean, result_objective=mean)
        rows = {name: column[:members] for name, column in extras.items()}
        archives, _ = state.archives.add(held[:members], first, rows)
        return state._replace(emitters=after, archives=archives)

    return Algorithm(init, ask, tell, lambda state: state.archives.dense(), config.batch)


def _selected(own: Population, held: jax.Array, score: Score) -> tuple[Population, Population]:
    """Count a batch (members, then children); return the members now and the next ones."""
    members, values = len(own.times), score.result_objective
    begins = own.times.sum() == 0
    present, again = (own.times > 0) & score.success[:members], values[:members]
    surprise = (again - own.total / jnp.maximum(own.times, 1)) ** 2 * own.times / (own.times + 1)
    noise = jnp.where(present, surprise, 0).sum() / jnp.maximum(present.sum(), 1)
    noise = jnp.where(own.noise > 0, _MEMORY * own.noise + (1 - _MEMORY) * noise, noise)
    # At first all members are the plan itself: one member with as many evaluations.
    only = jnp.arange(members) == 0
    total = jnp.where(begins, jnp.where(only, again.sum(), 0), own.total + again * present)
    count = jnp.where(begins, jnp.where(only, members, 0), own.times + present)
    count = jnp.where(begins & ~score.success[0], 0, count)
    noise = jnp.where(begins, again.var(ddof=1) if members > 1 else 0.0, noise)
    now = Population(held[:members], total, count.astype(jnp.int32), noise)
    children = held[members:]
    same = (children[:, None] == now.tiles[None]).all(axis=-1) & (now.times > 0)[None]
    new = score.success[members:] & ~same.any(axis=1)
    totals = jnp.concatenate([now.total, values[members:]])
    counts = jnp.concatenate([now.times, new.astype(jnp.int32)])
    worth = totals / jnp.maximum(counts, 1) - jnp.sqrt(noise / jnp.maximum(counts, 1))
    best = jax.lax.top_k(jnp.where(counts > 0, worth, -jnp.inf), members)[1]
    return now, Population(held[best], totals[best], counts[best], noise)


def changed(key: jax.Array, tiles: jax.Array, choices: int, odds: jax.Array) -> jax.Array:
    """Change a layout (int [h, w]) a few times; tiles from `choices` on stay where they are.

    `odds` float [3] are those of shifts, copies and trades. Consumes `key`.
    """
    number_key, key = jax.random.split(key)
    number = jnp.minimum(jax.random.geometric(number_key, 0.5), _MOST_CHANGES)

    def one(tiles: jax.Array, change: jax.Array) -> tuple[jax.Array, None]:
        own = jax.random.fold_in(key, change)
        return jnp.where(change < number, _change(own, tiles, choices, odds), tiles), None

    return jax.lax.scan(one, tiles, jnp.arange(_MOST_CHANGES))[0]


def _change(key: jax.Array, tiles: jax.Array, choices: int, odds: jax.Array) -> jax.Array:
    """Shift or copy one rectangle, or let two cells trade places."""
    size_key, first_key, other_key, step_key, way_key, kind_key, trade_key = jax.random.split(
        key, 7
    )
    sides = jnp.array(tiles.shape)
    # From 2 cells to a cell less than the side, small and large ones alike.
    share = jax.random.uniform(size_key, (2,))
    size = (2 * (sides / 2) ** share).astype(jnp.int32).clip(1, sides)
    first = jax.random.randint(first_key, (2,), 0, sides - size + 1)
    other = jax.random.randint(other_key, (2,), 0, sides - size + 1)
    size, first, other, sides = (one[:, None, None] for one in (size, first, other, sides))
    place = jnp.indices(tiles.shape)
    along, sign = jax.random.randint(way_key, (2,), 0, 2)
    step = jax.random.geometric(step_key, 0.5) * (2 * sign - 1)
    step = jnp.where(jnp.arange(2) == along, step, 0)[:, None, None]
    kind = jax.random.categorical(kind_key, jnp.log(odds))
    shifted, copied = first + (place - first - step) % size, other + place - first
    row, column = jnp.where(kind == 0, shifted, copied).clip(0, sides - 1)
    moved, inside = tiles[row, column], ((place >= first) & (place < first + size)).all(axis=0)
    moved = jnp.where(inside & (tiles < choices) & (moved < choices), moved, tiles)
    return jnp.where(kind == 2, _trade(trade_key, tiles, choices), moved)


def _trade(key: jax.Array, tiles: jax.Array, choices: int) -> jax.Array:
    """Exchange two cells that hold different tiles, the first one's kind drawn evenly."""
    kind_key, one_key, two_key = jax.random.split(key, 3)
    flat = tiles.reshape(-1)
    kind = jax.random.randint(kind_key, (), 0, choices)

    def draw(key: jax.Array, among: jax.Array) -> jax.Array:
        return jnp.argmax(jnp.where(among, jax.random.uniform(key, flat.shape), -1.0))

    one = draw(one_key, flat == kind)
    two = draw(two_key, (flat != flat[one]) & (flat < choices))
    free = (flat[one] < choices) & (flat[two] < choices)
    traded = flat.at[one].set(flat[two]).at[two].set(flat[one])
    return jnp.where(free, traded, flat).reshape(tiles.shape)
