"""The loop of a run: ask, evaluate, tell, log, checkpoint."""

import dataclasses
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qdenv.formats.layouts import write_layout
from qdenv.pipeline import Pipeline, PipelinedEvaluator, evaluate, make_pipeline
from qdenv.search.base import Algorithm
from qdenv.search.export import collector
from qdenv.search.growth import growing
from qdenv.search.registry import make_algorithm
from qdenv.training.config import RunConfig
from qdenv.training.progress import Progress
from qdenv.training.records import Metrics, RunDirectory
from qdenv.types import Array, Evaluation, Measure, RepairStatus


class Experiment(NamedTuple):
    """One run's parts, built from its configuration and nothing else.

    Attributes:
        measures: axes of the archive, with the configured ranges.
        pipeline: the chain from parameters to evaluation, with its domain.
        algorithm: the search.
        search_key: key of the search's initial state.
        evaluation_key: iteration ``i`` is evaluated with ``fold_in(evaluation_key, i)``.
    """

    measures: tuple[Measure, ...]
    pipeline: Pipeline
    algorithm: Algorithm
    search_key: jax.Array
    evaluation_key: jax.Array


def make_experiment(config: RunConfig) -> Experiment:
    """Build a run's parts.

    Args:
        config: the resolved configuration.

    Raises:
        InputError: a setting is impossible.
    """
    pipeline = make_pipeline(config.evaluation, repair_seed=config.seed)
    own = pipeline.domain.measures
    measures = tuple(
        measure._replace(low=low, high=high, cells=cells)
        for measure, (low, high, cells) in zip(
            own, config.archive or [m[1:4] for m in own], strict=True
        )
    )
    search_key, evaluation_key = jax.random.split(jax.random.key(config.seed))
    one = jax.ShapeDtypeStruct((1, pipeline.solution_size), np.float32)
    shapes = jax.eval_shape(lambda p, k: evaluate(pipeline, p, k), one, evaluation_key)
    extras = {name: np.zeros(leaf.shape[1:], leaf.dtype) for name, leaf in kept(shapes).items()}
    algorithm = make_algorithm(config.algorithm, pipeline.solution_size, measures, extras)
    return Experiment(measures, pipeline, algorithm, search_key, evaluation_key)


def kept(evaluation: Evaluation) -> dict[str, Array]:
    """Choose what the archive keeps of an evaluation beside its score.

    Both layouts, similarity, repair status, and every per-run number [B, S] of the simulator.
    """
    per_run = {
        name: leaf for name, leaf in evaluation.runs._asdict().items() if len(leaf.shape) == 2
    }
    return per_run | {
        "unrepaired": evaluation.unrepaired,
        "repaired": evaluation.repaired,
        "similarity": evaluation.similarity,
        "status": evaluation.status,
    }


def make_iteration(experiment: Experiment) -> Callable[[Any, jax.Array], Any]:
    """Make one whole iteration as one traceable function: (state, iteration) -> state.

    Under `jax.jit` the repair is the only thing that leaves the device (where the planner's
    backend is XLA); under `lax.scan` a run is one program. `train` runs the same iteration in
    parts instead, so that repairs and simulations overlap.
    """

    def iterate(state: Any, iteration: jax.Array) -> Any:
        solutions, state = experiment.algorithm.ask(state)
        key = jax.random.fold_in(experiment.evaluation_key, iteration)
        evaluation = evaluate(experiment.pipeline, solutions, key)
        return experiment.algorithm.tell(state, solutions, evaluation.score, kept(evaluation))

    return iterate


def train(config: RunConfig, path: str | Path, progress: bool = True) -> RunDirectory:
    """Search generators and leave everything in a new run directory.

    Args:
        config: the resolved configuration.
        path: the run directory to make.
        progress: show a progress bar.

    Raises:
        InputError: a setting is impossible, the folder holds a run already or is read-only.
    """
    experiment = make_experiment(config)
    run = RunDirectory.create(path, config, experiment.measures, experiment.pipeline.domain.tiles)
    return _run(experiment, config, run, progress)


def resume(path: str | Path, progress: bool = True, evaluations: int | None = None) -> RunDirectory:
    """Continue a run from its newest checkpoint, to the same archive bit for bit.

    Args:
        path: the run directory.
        progress: show a progress bar.
        evaluations: a new total, to go on beyond the configured one.

    Raises:
        InputError: there is no run, or it was written by a newer version.
    """
    run = RunDirectory.open(path)
    config = run.config
    if evaluations is not None:
        config = dataclasses.replace(config, evaluations=evaluations)
        run.write_config(config)
    return _run(make_experiment(config), config, run, progress)


def _run(
    experiment: Experiment, config: RunConfig, run: RunDirectory, progress: bool
) -> RunDirectory:
    """Iterate until all evaluations are done, from the newest checkpoint."""
    batch = experiment.algorithm.batch_size
    total = -(-config.evaluations // batch)
    with Progress(total * batch, progress) as shown:
        algorithm = growing(shown.over_algorithm(experiment.algorithm))
        collect = collector(algorithm)
        summarise = jax.jit(lambda state: _summary(algorithm, state))
        evaluator = PipelinedEvaluator(shown.over_pipeline(experiment.pipeline))

        done, state = run.load_checkpoint(algorithm.init(experiment.search_key))
        # Iterations after the checkpoint are run again, so their rows are written again, too.
        rows = [row for row in run.read_metrics() if row.iteration <= done]
        elapsed = rows[-1].seconds if rows else 0.0
        shown.begin(done * batch)
        for iteration in range(done + 1, total + 1):
            start = time.perf_counter()
            solutions, state = algorithm.ask(state)
            # Keys follow from the number of the iteration: a resumed run draws what this one would.
            key = jax.random.fold_in(experiment.evaluation_key, iteration)
            evaluation = evaluator(solutions, key)
            state = algorithm.tell(state, solutions, evaluation.score, kept(evaluation))
            summary = [float(value) for value in summarise(state)]
            elapsed += time.perf_counter() - start
            row = _metrics(iteration, batch, summary, round(elapsed, 3), evaluation)
            rows.append(row)
            run.write_metrics(rows)
            shown.update(
                batch,
                f"QD-score {row.qd_score:.1f}, coverage {row.coverage:.1%}, "
                f"best {row.best_objective:.3f}",
            )
            if iteration % config.checkpoint_every == 0 or iteration == total:
                run.save_checkpoint(iteration, state)
                _publish(run, experiment, collect(state))
    return run


def _metrics(
    iteration: int, batch: int, summary: list[float], seconds: float, evaluation: Evaluation
) -> Metrics:
    """Write an iteration's row: what the archive is worth, and what failed on the way there."""
    qd_score, coverage, best = summary
    failed = np.asarray(evaluation.status) >= RepairStatus.IMPOSSIBLE
    # A simulator whose runs cannot congest has no such field.
    congested = getattr(evaluation.runs, "congested", np.zeros(0, bool))
    return Metrics(
        iteration,
        iteration * batch,
        qd_score,
        coverage,
        best,
        seconds,
        failed_repairs=int(failed.sum()),
        congested_runs=int(np.asarray(congested).sum()),
    )


def _publish(run: RunDirectory, experiment: Experiment, archive: dict[str, np.ndarray]) -> None:
    """Write the archive and its best layout."""
    run.save_archive(archive)
    if len(archive["index"]) == 0:
        return
    row = int(np.argmax(archive["objective"]))
    details = {
        "domain": experiment.pipeline.domain.name,
        "objective": float(archive["objective"][row]),
        "measures": {
            measure.name: float(value)
            for measure, value in zip(experiment.measures, archive["measures"][row], strict=True)
        },
        "similarity": float(archive["similarity"][row]),
    }
    layout = archive["repaired"][row]
    write_layout(run.path / "best_layout.json", layout, experiment.pipeline.domain.tiles, **details)


def _summary(algorithm: Algorithm, state: Any) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Compute QD-score, coverage and best objective of the result archive."""
    archive = algorithm.archive(state)
    best = jnp.where(archive.filled.any(), archive.objectives.max(), 0.0)
    return archive.qd_score(), archive.coverage, best
