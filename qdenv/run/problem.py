"""What a run searches: its axes, what its archive holds, and what its algorithm observes."""

import jax
import jax.numpy as jnp
import numpy as np

from qdenv.pipeline import Pipeline, evaluate
from qdenv.search.axes import check_measures
from qdenv.search.base import Drawing, Problem
from qdenv.types import Array, Evaluation, InputError, Measure

# Not archived: where congestion ends a run it equals `end_timestep`.
_TRANSIENT_FIELD = "congested_at"


def problem_of(pipeline: Pipeline, measures: tuple[Measure, ...]) -> Problem:
    """Make the search problem of a pipeline over these axes."""
    domain = pipeline.domain
    one = jax.ShapeDtypeStruct((1, pipeline.solution_size), np.float32)
    shapes = jax.eval_shape(lambda p, k: evaluate(pipeline, p, k), one, jax.random.key(0))
    extras = {
        name: np.zeros(leaf.shape[1:], leaf.dtype) for name, leaf in _archived(shapes).items()
    }
    drawing = Drawing(
        lambda solutions: pipeline.grow(jnp.asarray(solutions)),
        domain.shape,
        len(domain.tiles),
        pipeline.choices,
        repairs=domain.rules is not None,
        usage="usage" in jax.eval_shape(observed, shapes),
    )
    return Problem(pipeline.solution_size, measures, extras, drawing)


def archive_axes(
    own: tuple[Measure, ...], ranges: tuple[tuple[float, float, int], ...]
) -> tuple[Measure, ...]:
    """Give a domain's measures the configured ranges.

    Args:
        own: the domain's.
        ranges: (low, high, cells) of each; empty for the domain's own.

    Raises:
        InputError: a range is empty, or there are more or fewer than measures.
    """
    if ranges and len(ranges) != len(own):
        names = " and ".join(repr(measure.name) for measure in own)
        raise InputError(
            f"archive: give low, high and cells for each of {names}: {3 * len(own)} numbers"
        )
    measures = tuple(
        measure._replace(low=low, high=high, cells=cells)
        for measure, (low, high, cells) in zip(own, ranges, strict=False)
    )
    check_measures(measures or own)
    return measures or own


def _archived(evaluation: Evaluation) -> dict[str, Array]:
    """Select what the archive holds of an evaluation beside its score.

    Both layouts, similarity, repair status, and every per-run number [B, S] of the simulator but
    `_TRANSIENT_FIELD`.
    """
    per_run = {
        name: leaf
        for name, leaf in evaluation.runs._asdict().items()
        if len(leaf.shape) == 2 and name != _TRANSIENT_FIELD
    }
    return per_run | {
        "unrepaired": evaluation.unrepaired,
        "repaired": evaluation.repaired,
        "similarity": evaluation.similarity,
        "status": evaluation.status,
    }


def observed(evaluation: Evaluation) -> dict[str, Array]:
    """Select what an algorithm observes of an evaluation: what is archived, and how cells are used.

    ``usage`` is the share of agent-steps on each cell, float32 [B, H, W], averaged over the runs;
    absent where the simulator draws no such map.
    """
    usage = getattr(evaluation.runs, "usage", None)
    return _archived(evaluation) | ({} if usage is None else {"usage": usage.mean(axis=1)})
