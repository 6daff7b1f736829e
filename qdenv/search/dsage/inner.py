"""The inner loop of DSAGE: MAP-Elites whose solutions only the surrogate sees."""

from collections.abc import Callable

import jax
import jax.numpy as jnp

from qdenv.search.archive import GridArchive
from qdenv.search.base import Problem
from qdenv.search.dsage.settings import DsageConfig
from qdenv.search.dsage.tiles import mutate_tiles, random_tiles
from qdenv.types import Score

Predict = Callable[[jax.Array], Score]  # solutions int8 [B, P] -> what to think of them


def search_surrogate(
    config: DsageConfig, problem: Problem, choices: int, predict: Predict, key: jax.Array
) -> GridArchive:
    """Fill a fresh archive by predictions: one scan, traceable.

    Args:
        config: the numbers.
        problem: what is searched.
        choices: tiles that each parameter may name.
        predict: what solutions are worth.
        key: consumed.

    Returns:
        the archive of solutions int8 [C, P] by predicted objective and measures.
    """
    cells, count = problem.solution_dim, config.inner_batch
    example = jax.ShapeDtypeStruct((cells,), jnp.int8)

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

    first = GridArchive.empty(example, problem.measures)
    return jax.lax.scan(iterate, first, jnp.arange(config.inner_iterations))[0]
