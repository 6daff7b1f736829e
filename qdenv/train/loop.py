"""The loop of a run: ask, evaluate, tell, log, checkpoint."""

import dataclasses
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

from qdenv.domains import find_domain
from qdenv.domains.base import Domain
from qdenv.formats.layouts import write_layout
from qdenv.pipeline import Pipeline, PipelinedEvaluator, evaluate, make_pipeline
from qdenv.search.base import Algorithm
from qdenv.search.registry import make_algorithm
from qdenv.train.config import RunConfig
from qdenv.train.records import Metrics, RunDirectory
from qdenv.types import Array, Evaluation, Measure


class Study(NamedTuple):
    """One run's parts, built from its configuration and nothing else.

    Attributes:
        domain: what is searched.
        measures: axes of the archive, with the configured ranges.
        pipeline: the chain from parameters to evaluation.
        algorithm: the search.
        search_key: key of the search's initial state.
        evaluation_key: iteration ``i`` is evaluated with ``fold_in(evaluation_key, i)``.
    """

    domain: Domain
    measures: tuple[Measure, ...]
    pipeline: Pipeline
    algorithm: Algorithm
    search_key: Array
    evaluation_key: Array


def make_study(config: RunConfig, domain: Domain | None = None) -> Study:
    """Build a run's parts.

    Args:
        config: the resolved configuration.
        domain: a domain of your own in place of the registered one.

    Raises:
        InputError: a setting is impossible.
    """
    domain = domain or find_domain(config.evaluation.domain)
    pipeline = make_pipeline(domain, config.evaluation, repair_seed=config.seed)
    measures = tuple(
        measure._replace(low=low, high=high, cells=cells)
        for measure, (low, high, cells) in zip(
            domain.measures, config.archive or [m[1:4] for m in domain.measures], strict=True
        )
    )
    search_key, evaluation_key = jax.random.split(jax.random.key(config.seed))
    one = jax.ShapeDtypeStruct((1, pipeline.solution_size), np.float32)
    shapes = jax.eval_shape(lambda p, k: evaluate(pipeline, p, k), one, evaluation_key)
    extras = {name: np.zeros(leaf.shape[1:], leaf.dtype) for name, leaf in kept(shapes).items()}
    algorithm = make_algorithm(config.algorithm, pipeline.solution_size, measures, extras)
    return Study(domain, measures, pipeline, algorithm, search_key, evaluation_key)


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


def make_iteration(study: Study) -> Callable[[Any, Array], Any]:
    """Make one whole iteration as one traceable function: (state, iteration) -> state.

    Under `jax.jit` the repair is the only thing that leaves the device; under `lax.scan` a run
    is one program.
    """

    def iterate(state: Any, iteration: Array) -> Any:
        solutions, state = study.algorithm.ask(state)
        key = jax.random.fold_in(study.evaluation_key, iteration)
        evaluation = evaluate(study.pipeline, solutions, key)
        return study.algorithm.tell(state, solutions, evaluation.score, kept(evaluation))

    return iterate


def train(
    config: RunConfig, path: str | Path, domain: Domain | None = None, progress: bool = True
) -> RunDirectory:
    """Search generators and leave everything in a new run directory.

    Args:
        config: the resolved configuration.
        path: the run directory to make.
        domain: a domain of your own in place of the registered one.
        progress: show a progress bar.

    Raises:
        InputError: a setting is impossible, the folder holds a run already or is read-only.
    """
    study = make_study(config, domain)
    run = RunDirectory.create(path, config, study.measures, study.domain.tiles)
    return _run(study, config, run, progress)


def resume(
    path: str | Path,
    domain: Domain | None = None,
    progress: bool = True,
    evaluations: int | None = None,
) -> RunDirectory:
    """Continue a run from its newest checkpoint, to the same archive bit for bit.

    Args:
        path: the run directory.
        domain: the domain of your own the run was started with, if it was.
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
    return _run(make_study(config, domain), config, run, progress)


def _run(study: Study, config: RunConfig, run: RunDirectory, progress: bool) -> RunDirectory:
    """Iterate until all evaluations are done, from the newest checkpoint."""
    init = jax.jit(study.algorithm.init)
    ask = jax.jit(study.algorithm.ask, donate_argnums=0)
    tell = jax.jit(study.algorithm.tell, donate_argnums=0)
    summarise = jax.jit(lambda state: _summary(study.algorithm, state))
    evaluator = PipelinedEvaluator(study.pipeline)

    done, state = run.load_checkpoint(init(study.search_key))
    rows = [row for row in run.read_metrics() if row.iteration <= done]
    elapsed = rows[-1].seconds if rows else 0.0
    batch = study.algorithm.batch_size
    total = -(-config.evaluations // batch)
    bar = tqdm(
        total=total * batch, initial=done * batch, unit="eval", disable=not progress, smoothing=0.1
    )
    for iteration in range(done + 1, total + 1):
        start = time.perf_counter()
        solutions, state = ask(state)
        key = jax.random.fold_in(study.evaluation_key, iteration)
        evaluation = evaluator(solutions, key)
        state = tell(state, solutions, evaluation.score, kept(evaluation))
        summary = [float(value) for value in summarise(state)]
        elapsed += time.perf_counter() - start
        row = Metrics(iteration, iteration * batch, *summary, round(elapsed, 3))
        rows.append(row)
        run.write_metrics(rows)
        bar.update(batch)
        bar.set_postfix_str(
            f"QD-score {row.qd_score:.1f}, coverage {row.coverage:.1%}, "
            f"best {row.best_objective:.3f}"
        )
        if iteration % config.checkpoint_every == 0 or iteration == total:
            run.save_checkpoint(iteration, state, init(study.search_key))
            _publish(run, study, elites(study.algorithm, state))
    bar.close()
    return run


def _publish(run: RunDirectory, study: Study, archive: dict[str, np.ndarray]) -> None:
    """Write the archive and its best layout."""
    run.save_archive(archive)
    if len(archive["index"]) == 0:
        return
    row = int(np.argmax(archive["objective"]))
    details = {
        "domain": study.domain.name,
        "objective": float(archive["objective"][row]),
        "measures": {
            measure.name: float(value)
            for measure, value in zip(study.measures, archive["measures"][row], strict=True)
        },
        "similarity": float(archive["similarity"][row]),
    }
    layout = archive["repaired"][row]
    write_layout(run.path / "best_layout.json", layout, study.domain.tiles, **details)


def _summary(algorithm: Algorithm, state: Any) -> tuple[Array, Array, Array]:
    """Compute QD-score, coverage and best objective of the result archive."""
    archive = algorithm.archive(state)
    best = jnp.where(archive.filled.any(), archive.objectives.max(), 0.0)
    return archive.qd_score(), archive.coverage, best


def elites(algorithm: Algorithm, state: Any) -> dict[str, np.ndarray]:
    """List the result archive's filled cells: solution, objective, measures, index, extras."""
    archive = algorithm.archive(state)
    index = np.flatnonzero(np.asarray(archive.filled))
    columns = {
        "solution": archive.genotypes,
        "objective": archive.objectives,
        "measures": archive.descriptors,
        **archive.extra_scores,
    }
    return {"index": index} | {name: np.asarray(rows)[index] for name, rows in columns.items()}
