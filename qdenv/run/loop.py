"""The loop of a run: ask, evaluate, tell, log, checkpoint."""

import contextlib
import dataclasses
import shlex
import time
from collections.abc import Callable
from functools import partial, wraps
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from qdenv.interrupt import advise, save_first, undisturbed
from qdenv.pipeline import Pipeline, PipelinedEvaluator, evaluate, make_pipeline
from qdenv.progress import Bar
from qdenv.run.checkpoint import check_same_search, result_settings
from qdenv.run.config import RunConfig, check
from qdenv.run.directory import RunDirectory, find_start, read_start
from qdenv.run.evaluate_async import AsyncEvaluation, Search, begin_search
from qdenv.run.executors.base import Execution, open_evaluator
from qdenv.run.log import Log
from qdenv.run.manifest import archive_schema
from qdenv.run.problem import archive_axes, observed, problem_of
from qdenv.run.publish import Publisher
from qdenv.search.base import Algorithm, growing, is_whole
from qdenv.search.registry import make_algorithm
from qdenv.types import InputError, Measure


class Experiment(NamedTuple):
    """One run's parts, built from its configuration and nothing else."""

    measures: tuple[Measure, ...]  # axes of the archive, with the configured ranges
    pipeline: Pipeline  # the chain from parameters to evaluation, with its domain
    algorithm: Algorithm  # the search
    search_key: jax.Array  # key of the search's initial state
    evaluation_key: jax.Array  # iteration ``i`` is evaluated with ``fold_in(evaluation_key, i)``

    def settings(self, config: RunConfig) -> dict[str, Any]:
        """List what decides the result, for checkpoints."""
        return result_settings(config, self.measures, self.pipeline.domain.reads())


def make_experiment(config: RunConfig, start: np.ndarray | None = None) -> Experiment:
    """Build a run's parts.

    Args:
        config: the resolved configuration.
        start: parameters from which the search begins, float [P]; what `config.start` names
            unless given.

    Raises:
        InputError: a setting is impossible.
    """
    pipeline = make_pipeline(config.evaluation, repair_seed=config.seed)
    measures = archive_axes(pipeline.domain.measures, config.archive)
    search_key, evaluation_key = jax.random.split(jax.random.key(config.seed))
    start = find_start(config) if start is None else start
    algorithm = make_algorithm(config.algorithm, problem_of(pipeline, measures), start)
    return Experiment(measures, pipeline, algorithm, search_key, evaluation_key)


def make_iteration(experiment: Experiment) -> Callable[[Any, jax.Array], Any]:
    """Make one whole iteration as one traceable function: (state, iteration) -> state.

    Under `jax.jit` the repair is the only thing that leaves the device (where the planner's
    backend is XLA); under `lax.scan` a run is one program. `train` runs the same iteration in
    parts instead, so that repairs and simulations overlap.

    Raises:
        InputError: the algorithm asks ahead, which one iteration after the other cannot.
    """
    if experiment.algorithm.ahead:
        raise InputError("a whole iteration as one function asks nothing ahead: leave ahead at 0")

    def iterate(state: Any, iteration: jax.Array) -> Any:
        solutions, state = experiment.algorithm.ask(state)
        key = jax.random.fold_in(experiment.evaluation_key, iteration)
        evaluation = evaluate(experiment.pipeline, solutions, key)
        return experiment.algorithm.tell(state, solutions, evaluation.score, observed(evaluation))

    return iterate


def train(
    config: RunConfig,
    path: str | Path,
    progress: bool = True,
    execution: Execution = Execution(),  # noqa: B008 (frozen)
) -> RunDirectory:
    """Search generators and leave everything in a new run directory.

    Args:
        config: the resolved configuration.
        path: the run directory to make.
        progress: show a progress bar.
        execution: where layouts are repaired and simulated.

    Raises:
        InputError: a setting is impossible, no layout could count, the folder holds a run already
            or is read-only.
    """
    check(config)
    start = find_start(config)
    experiment = make_experiment(config, start)
    run = RunDirectory(Path(path))
    with run.locked():
        schema = archive_schema(experiment.pipeline.domain, experiment.measures)
        run = RunDirectory.create(path, config, schema, start)
        return _run(experiment, config, run, progress, execution)


def resume(
    path: str | Path,
    progress: bool = True,
    evaluations: int | None = None,
    execution: Execution = Execution(),  # noqa: B008 (frozen)
) -> RunDirectory:
    """Continue a run from its newest checkpoint, to the same archive bit for bit.

    Args:
        path: the run directory.
        progress: show a progress bar.
        evaluations: a new total, to go on beyond the configured one.
        execution: where layouts are repaired and simulated.

    Raises:
        InputError: there is no run, it was written by a newer version or with other settings,
            more evaluations are done already, or another process is at work on it.
    """
    run = RunDirectory.open(path)
    with run.locked():
        config = run.config
        if evaluations is not None:
            config = dataclasses.replace(config, evaluations=evaluations)
        # A domain may have other ranges today than when the run began.
        axes = config.archive or tuple(axis[1:4] for axis in run.measures)
        experiment = make_experiment(dataclasses.replace(config, archive=axes), read_start(run))
        return _run(experiment, config, run, progress, execution)


def _restore(
    experiment: Experiment, config: RunConfig, run: RunDirectory, algorithm: Algorithm
) -> tuple[int, Search]:
    """Restore the newest checkpoint: (iterations, the search after them)."""
    manifest, search = run.load_checkpoint(begin_search(algorithm, experiment.search_key))
    # A checkpoint without settings is compared by the axes in the run's manifest.
    axes = {"archive": [list(axis[1:4]) for axis in run.measures]}
    check_same_search(experiment.settings(config), manifest.settings or axes, run.path)
    if config != run.config:
        done, batch = manifest.iteration, algorithm.batch_size
        if -(-config.evaluations // batch) < done:
            raise InputError(
                f"{done * batch} evaluations are done already: ask for more than that, or leave "
                "--evaluations out"
            )
        run.write_config(config)
    return manifest.iteration, search


def _announced(bar: Bar, what: str, function: Callable) -> Callable:
    """Have the bar name a function while jax traces it, which is when it is compiled next."""

    @wraps(function)
    def traced(*arguments: Any) -> Any:
        bar.wait_for(f"compiling and running the {what}")
        return function(*arguments)

    return traced


def _run(
    experiment: Experiment,
    config: RunConfig,
    run: RunDirectory,
    progress: bool,
    execution: Execution,
) -> RunDirectory:
    """Iterate until all evaluations are done, from the newest checkpoint."""
    batch = experiment.algorithm.batch_size
    total = -(-config.evaluations // batch)
    advise(f"`qdenv resume {shlex.quote(str(run.path))}` goes on")
    settings = experiment.settings(config)
    with contextlib.ExitStack() as stack:
        bar = Bar("", total * batch, progress, unit="eval")
        algorithm, pipeline = experiment.algorithm, experiment.pipeline
        ask, tell = (_announced(bar, "search", one) for one in (algorithm.ask, algorithm.tell))
        algorithm = growing(algorithm._replace(ask=ask, tell=tell))
        publisher = Publisher(run, experiment.pipeline.domain, experiment.measures, algorithm)
        pipeline = pipeline._replace(
            grow=_announced(bar, "generator and repair", pipeline.grow),
            simulate=_announced(bar, "simulator", pipeline.simulate),
            score=_announced(bar, "score", pipeline.score),
        )
        layouts = stack.enter_context(open_evaluator(execution, config, pipeline, bar.update))
        evaluator = PipelinedEvaluator(pipeline, layouts)

        begun, search = _restore(experiment, config, run, algorithm)
        log = Log(run.path, begun)
        if begun >= total:
            publisher.publish(search)  # it may be older, where a run was killed at its very end
        bar.begin("", total * batch, begun * batch)
        stack.enter_context(bar)  # not before: a run that is refused shows its line alone
        key = experiment.evaluation_key
        in_flight = AsyncEvaluation(algorithm, evaluator, key, total, begun, search)
        try:
            while in_flight.done < total:
                start = time.perf_counter()
                with bar.waiting_for("the search prepares the next population"):
                    in_flight.submit()
                evaluation = in_flight.wait()
                with undisturbed:
                    in_flight.collect(evaluation)
                    done, search = in_flight.done, in_flight.search
                    summary, spent = publisher.summary(search), time.perf_counter() - start
                    notes = algorithm.notes(search.state)
                    row = log.add(done, batch, summary, spent, evaluation, notes)
                    bar.note(str(row))
                    save_first(partial(publisher.save, done, search, settings))
                    if done % config.checkpoint_every == 0 or done == total or publisher.has_time:
                        save_first(None)
                        publisher.save(done, search, settings)
        except KeyboardInterrupt:  # in notebooks; programs end otherwise, see `interrupt`
            done, search = in_flight.done, in_flight.search
            if done > begun and publisher.saved != done and is_whole(search):
                publisher.save(done, search, settings)
            raise
    return run
