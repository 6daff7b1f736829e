"""How many elites grow, step by step: for pictures that move."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from qdenv.domains.base import Domain
from qdenv.generate.generator import GENERATORS, Generator
from qdenv.lazy import jax, jnp
from qdenv.settings import EvaluationConfig

Grower = Callable[[np.ndarray], np.ndarray]


def make_grower(config: EvaluationConfig, domain: Domain) -> tuple[int, Grower]:
    """Make the function that grows solutions at the trained size and keeps every step.

    Args:
        config: whose generator, and how many steps.
        domain: at the trained size.

    Returns:
        (steps C, float32 [B, P] -> framed layouts int8 [B, C + 1, H, W]); no steps where nothing
        grows. Another B is compiled anew.
    """
    from qdenv.pipeline import canvas_of  # imports both compilers

    generator = GENERATORS.make(config.generator, canvas_of(domain))
    steps = generator.steps

    @jax.jit
    def grow(solutions: jax.Array) -> jax.Array:
        framed = jax.vmap(jax.vmap(domain.frame))(_frames(generator, solutions, steps))
        return jnp.asarray(framed)

    return steps, lambda solutions: np.asarray(grow(jnp.asarray(solutions)))


def _frames(generator: Generator, solutions: jax.Array, steps: int) -> jax.Array:
    if generator.frames is not None:
        return generator.frames(solutions, steps)
    # Whoever tells only how it ends is asked again and again.
    after = jnp.arange(steps + 1)
    return jnp.moveaxis(jax.lax.map(lambda step: generator.grow(solutions, step), after), 0, 1)


def spread(cells: np.ndarray, first: int) -> Iterator[int]:
    """Order elites so that the first few of them, however many, lie evenly over the archive.

    Each is the one farthest from all before it (Gonzalez 1985, "Clustering to minimize the maximum
    intercluster distance", https://doi.org/10.1016/0304-3975(85)90224-5).

    Args:
        cells: int [elites, M], where they lie.
        first: row of the one to begin with.

    Yields:
        each row once.
    """
    points = cells.astype(np.int32)
    distance = np.full(len(points), np.iinfo(np.int32).max)
    row = first
    for _ in range(len(points)):
        yield row
        np.minimum(distance, ((points - points[row]) ** 2).sum(axis=1), out=distance)
        distance[row] = -1
        row = int(distance.argmax())
