"""What searches with a surrogate let it learn from."""

from collections.abc import Mapping

import jax
import jax.numpy as jnp

from qdenv.search.base import Drawing, Problem
from qdenv.surrogate.samples import Samples
from qdenv.surrogate.surrogate import Aspect
from qdenv.types import Array, InputError, Score


def drawing_of(problem: Problem, name: str) -> Drawing:
    """Return what the solutions of a problem look like.

    Raises:
        InputError: its solutions are nothing but numbers; the message names the algorithm.
    """
    if problem.drawing is None:
        raise InputError(f"{name} learns from drawings: this problem has none")
    return problem.drawing


def aspect_of(problem: Problem, drawing: Drawing) -> Aspect:
    """Describe the inputs and outputs of a problem's surrogate."""
    measures = len(problem.measures)
    return Aspect(drawing.shape, drawing.kinds, measures, drawing.repairs, drawing.usage)


def samples_of(
    drawing: Drawing, solutions: jax.Array, score: Score, extras: Mapping[str, Array]
) -> Samples:
    """Collect the samples of a batch.

    Args:
        drawing: what solutions look like.
        solutions: float [B, P].
        score: `Score` with leading axis B.
        extras: with "repaired" and "usage", where the drawing has them.
    """
    drawn = drawing.draw(solutions)
    numbers = [score.objective[:, None], score.result_objective[:, None], score.measures]
    return Samples(
        drawn,
        jnp.asarray(extras["repaired"]) if drawing.repairs else drawn,
        jnp.asarray(extras["usage"]) if drawing.usage else jnp.zeros(drawn.shape),
        jnp.concatenate(numbers, axis=1),
    )
