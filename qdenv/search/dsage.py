"""DSAGE: evaluate truly, learn, search the surrogate by MAP-Elites, evaluate its best.

Bhatt, Tjanaka, Fontaine and Nikolaidis 2022, "Deep surrogate assisted generation of environments",
https://arxiv.org/abs/2206.04199, as Zhang et al. 2023 use it for layouts.
"""

import functools
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qdenv.search.archive import GridArchive
from qdenv.search.base import Algorithm, Problem, StoredArchive, check_batch, plain_key
from qdenv.search.model import Model, ModelState
from qdenv.search.settings import DsageConfig
from qdenv.types import Array, Extras, InputError, Measure, Score

# Tiles that a geometric draw changes at most: more come once in 65,000 mutations (2^-16), and
# the shapes must be static.
_MOST_MUTATIONS = 16


class DsageState(NamedTuple):
    """State of DSAGE; one pytree."""

    key: jax.Array
    queue: jax.Array  # int8 [Q, P], solutions to be evaluated truly, the last ones first
    waiting: jax.Array  # int32, how many of them still are
    model: ModelState  # the surrogate
    archives: StoredArchive  # of true evaluations, without a learning archive


def dsage(config: DsageConfig, problem: Problem, x0: Array | None = None) -> Algorithm:
    """Make DSAGE: random solutions first, then those that the surrogate rates best.

    When the queue is empty, `ask` fits the surrogate to the newest evaluations, fills a fresh
    archive by its predictions, and queues one elite of every block of cells, and as many more as
    fill the last batch. `x0` must be None: a search of tiles begins with random ones. Raises
    InputError if solutions are no tiles.
    """
    model = Model(config.surrogate, problem, "dsage")
    batch, size, choices = config.batch, problem.solution_dim, model.encoding.choices
    if choices < 2:
        raise InputError("dsage searches tiles: its generator is direct, not an automaton")
    if x0 is not None:
        raise InputError("dsage begins with random solutions: leave the start out")
    blocks = blocks_along(problem.measures, config.downsample)
    block = block_of_cells(problem.measures, blocks)
    first = -(-config.initial // batch) * batch  # whole batches
    capacity = max(first, -(-math.prod(blocks) // batch) * batch)  # Q

    def init(key: jax.Array) -> DsageState:
        key, queue_key, net_key = jax.random.split(plain_key(key), 3)
        return DsageState(
            key=key,
            queue=random_tiles(queue_key, capacity, size, choices),
            waiting=jnp.int32(first),
            model=model.init(net_key),
            archives=StoredArchive.empty(problem, jnp.zeros(size, jnp.float32), batch),
        )

    def ask(state: DsageState) -> tuple[jax.Array, DsageState]:
        key, refill_key = jax.random.split(state.key)
        known = state.model

        def refill() -> tuple:
            fit_key, inner_key, queue_key, fresh_key = jax.random.split(refill_key, 4)
            fitted, losses = model.surrogate.fit(known.fitted, known.ring, fit_key)
            predict = functools.partial(model.predict, fitted)
            predicted = search_surrogate(config, problem, choices, predict, inner_key)
            fresh = random_tiles(fresh_key, capacity, size, choices)
            return fitted, losses, *choose_waiting(queue_key, predicted, block, fresh, batch)

        # The ring stays outside of the branch, whose results are copied.
        fitted, losses, queue, waiting = jax.lax.cond(
            state.waiting == 0,
            refill,
            lambda: (known.fitted, known.losses, state.queue, state.waiting),
        )
        rows = jax.lax.dynamic_slice_in_dim(queue, waiting - batch, batch)
        known = known._replace(fitted=fitted, losses=losses)
        state = state._replace(key=key, model=known, queue=queue, waiting=waiting)
        return rows.astype(jnp.float32), state

    def tell(state: DsageState, solutions: Array, score: Score, extras: Extras) -> DsageState:
        solutions, score = check_batch(solutions, score)
        archives, _ = state.archives.add(solutions, score, extras)
        return state._replace(
            waiting=state.waiting - batch,
            model=model.observe(state.model, solutions, score, extras),
            archives=archives,
        )

    return Algorithm(init, ask, tell, lambda state: state.archives.dense(), batch, model.notes)


def search_surrogate(
    config: DsageConfig,
    problem: Problem,
    choices: int,
    predict: Callable[[jax.Array], Score],
    key: jax.Array,
) -> GridArchive:
    """Run the inner loop, MAP-Elites on predictions: one scan, traceable; consumes `key`.

    `predict` scores solutions int8 [B, P], each of whose tiles is one of `choices`. Returns the
    archive of solutions int8 [C, P] by predicted objective and measures.
    """
    cells, count = problem.solution_dim, config.inner_batch

    def iterate(archive: GridArchive, iteration: jax.Array) -> tuple[GridArchive, None]:
        keys = jax.random.split(jax.random.fold_in(key, iteration), 3)
        fresh = random_tiles(keys[0], count, cells, choices)
        parents = archive.sample_solutions(keys[1], count, fresh)
        children = mutate_tiles(keys[2], parents, choices, config.mutations)
        solutions = jnp.where(iteration < config.inner_random, fresh, children)
        score = predict(solutions)
        archive, _ = archive.insert(
            solutions, score.objective, score.measures, success=score.success
        )
        return archive, None

    first = GridArchive.empty(jax.ShapeDtypeStruct((cells,), jnp.int8), problem.measures)
    return jax.lax.scan(iterate, first, jnp.arange(config.inner_iterations))[0]


def random_tiles(key: jax.Array, count: int, cells: int, choices: int) -> jax.Array:
    """Draw every tile evenly, int8 [count, cells]. Consumes `key`."""
    return jax.random.randint(key, (count, cells), 0, choices, jnp.int8)


def mutate_tiles(key: jax.Array, parents: jax.Array, choices: int, mutations: int) -> jax.Array:
    """Draw `mutations` different tiles of each parent (int8 [B, P]) again, evenly among `choices`.

    A tile may be drawn as it was. With 0 mutations their number is drawn, geometric with mean 2.
    Consumes `key`.
    """
    many, cells = parents.shape
    place_key, number_key, tile_key = jax.random.split(key, 3)
    most = min(mutations or _MOST_MUTATIONS, cells)
    # The places of the largest of random numbers: different ones, in random order.
    places = jax.lax.top_k(jax.random.uniform(place_key, parents.shape), most)[1]
    number = jnp.full(many, most) if mutations else jax.random.geometric(number_key, 0.5, (many,))
    changed = jnp.arange(most)[None] < number[:, None]
    tiles = jax.random.randint(tile_key, places.shape, 0, choices, jnp.int8)
    target = jnp.where(changed, places, cells)  # others: out of bounds
    return parents.at[jnp.arange(many)[:, None], target].set(tiles, mode="drop")


def blocks_along(measures: Sequence[Measure], blocks: Sequence[int]) -> tuple[int, ...]:
    """Return the number of blocks along each measure: `blocks`, at most one per cell.

    Half of the cells along the first measure and a quarter along the others if `blocks` is empty,
    as published for the warehouse. Raises InputError if the number of axes is another.
    """
    if blocks and len(blocks) != len(measures):
        raise InputError(f"downsample: give {len(measures)} numbers of blocks, one per measure")
    published = [axis.cells // (4 if place else 2) for place, axis in enumerate(measures)]
    return tuple(
        max(1, min(count, axis.cells))
        for count, axis in zip(blocks or published, measures, strict=True)
    )


def block_of_cells(measures: Sequence[Measure], blocks: Sequence[int]) -> np.ndarray:
    """Compute the block of each cell (int32 [C]); blocks are as equal as whole cells allow."""
    shape = tuple(axis.cells for axis in measures)
    cells = np.unravel_index(np.arange(math.prod(shape)), shape)
    along = [index * count // size for index, size, count in zip(cells, shape, blocks, strict=True)]
    return np.ravel_multi_index(tuple(along), tuple(blocks)).astype(np.int32)


def draw_per_block(key: jax.Array, filled: jax.Array, block: np.ndarray) -> jax.Array:
    """Mark one filled cell of each block that has any; bool [C], `block` being int32 [C]."""
    # A random order in place of random numbers: no two cells of a block are ever equal.
    rank = jnp.where(filled, jax.random.permutation(key, len(block)), -1)
    best = jax.ops.segment_max(rank, block, num_segments=int(block.max()) + 1)
    return filled & (rank == best[block])


def choose_waiting(
    key: jax.Array, predicted: GridArchive, block: np.ndarray, fresh: jax.Array, batch: int
) -> tuple[jax.Array, jax.Array]:
    """Choose what is evaluated next: an elite of each block, and others up to whole batches.

    Random solutions, the rows of `fresh` (int8 [Q, P], whole batches, at least one row per block),
    fill the last batch where the archive of the inner loop has too few elites. Returns the queue
    int8 [Q, P], and how many of its first rows wait (int32). Consumes `key`.
    """
    block_key, order_key = jax.random.split(key)
    drawn, cells = draw_per_block(block_key, predicted.filled, block), len(block)
    size = len(fresh)
    # Elites of blocks come first (1 to 2), then other elites (0 to 1), then empty cells (-1).
    priority = jnp.where(predicted.filled, jax.random.uniform(order_key, drawn.shape) + drawn, -1.0)
    priority = jnp.pad(priority, (0, max(size - cells, 0)), constant_values=-1.0)
    value, cell = jax.lax.top_k(priority, size)
    elites = predicted.genotypes[jnp.minimum(cell, cells - 1)]
    waiting = jnp.maximum((drawn.sum(dtype=jnp.int32) + batch - 1) // batch, 1) * batch
    return jnp.where((value >= 0)[:, None], elites, fresh), waiting
