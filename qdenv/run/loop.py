"""The loop of a run: ask, evaluate, tell, log, checkpoint."""

import contextlib
import dataclasses
import math
import time
from collections.abc import Callable
from functools import partial, wraps
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from qdenv.devices import check_memory
from qdenv.guidance import unscaled_costs
from qdenv.interrupt import advise, save_first, undisturbed
from qdenv.io.arrays import write_arrays
from qdenv.io.files import write_csv
from qdenv.io.layouts import write_layout
from qdenv.pipeline import PipelinedEvaluator
from qdenv.progress import Bar
from qdenv.run.archive import best_row
from qdenv.run.checkpoint import load_newest, save_checkpoint
from qdenv.run.config import RunConfig, check
from qdenv.run.directory import METRICS, NOTES, Metrics, RunDirectory, find_start
from qdenv.run.evaluate import AsyncEvaluation, Search, open_evaluator
from qdenv.run.executors import Execution
from qdenv.run.experiment import Experiment, build_experiment
from qdenv.search.base import Algorithm, collector, growing
from qdenv.types import Evaluation, InputError, RepairStatus

_SAVING_SHARE = 0.03  # of a run's time, for checkpoints beyond those that its settings state
_LONGEST = 240.0  # seconds after which an iteration ends with a checkpoint, whatever it costs


def train(
    config: RunConfig,
    path: str | Path,
    progress: bool = True,
    execution: Execution = Execution(),  # noqa: B008 (frozen)
    minutes: float = math.inf,
    start: np.ndarray | None = None,
) -> RunDirectory:
    """Search generators and leave everything in a new run directory.

    It begins at `start` (float [P]), by default what `config.start` names. The search pauses after
    the iteration in which `minutes` have passed; `resume` goes on. Raises InputError if a setting
    is impossible, no layout could count, the folder holds a run already or is read-only.
    """
    check(config)
    start = find_start(config) if start is None else start
    experiment = build_experiment(config, start)
    # The state of the search alone, before a folder exists.
    fewer = "fewer emitters, a smaller batch or a smaller generator"
    check_memory(experiment.algorithm.init, experiment.search_key, "this search", fewer)
    run = RunDirectory(Path(path))
    run.demand_new()  # before a lock is left there
    with run.locked():
        run = RunDirectory.create(path, config, experiment.measures, start)
        return _run(experiment, config, run, progress, execution, minutes)


def resume(
    path: str | Path,
    progress: bool = True,
    evaluations: int | None = None,
    execution: Execution = Execution(),  # noqa: B008 (frozen)
    minutes: float = math.inf,
) -> RunDirectory:
    """Continue a run from its newest checkpoint, to the same archive bit for bit.

    `evaluations` is a new total, to go on beyond the configured one; it pauses after `minutes`.
    Raises InputError if there is no run, it was written by a newer version or with other settings,
    more evaluations are done already, or another process is at work on it.
    """
    run = RunDirectory.open(path)
    with run.locked():
        config = run.config
        if evaluations is not None:
            config = dataclasses.replace(config, evaluations=evaluations)
        # A domain may have other ranges today than when the run began.
        axes = config.archive or tuple(axis[1:4] for axis in run.measures)
        experiment = build_experiment(dataclasses.replace(config, archive=axes), run.read_start())
        return _run(experiment, config, run, progress, execution, minutes)


def _run(
    experiment: Experiment,
    config: RunConfig,
    run: RunDirectory,
    progress: bool,
    execution: Execution,
    minutes: float,
) -> RunDirectory:
    """Iterate until all evaluations are done, from the newest checkpoint."""
    end = time.perf_counter() + 60 * minutes
    algorithm, pipeline = experiment.algorithm, experiment.pipeline
    batch, settings = algorithm.batch_size, experiment.settings(config)
    total = -(-config.evaluations // batch)
    advise(run.path)
    bar = Bar("", total * batch, progress, unit="eval")
    announced = partial(_announced, bar)
    parts = {"grow": "generator and repair", "simulate": "simulator", "score": "score"}
    named: Any = {part: announced(name, getattr(pipeline, part)) for part, name in parts.items()}
    pipeline = pipeline._replace(**named)
    ask, tell = announced("search", algorithm.ask), announced("search", algorithm.tell)
    algorithm = growing(algorithm._replace(ask=ask, tell=tell))
    with contextlib.ExitStack() as stack:
        layouts = stack.enter_context(open_evaluator(execution, config, pipeline, bar.update))
        publisher = Publisher(run, experiment, algorithm, settings)
        begun, search = publisher.load(Search.begin(algorithm, experiment.search_key))
        if config != run.config:
            if total < begun:
                more = "give a larger number, or leave --evaluations out"
                raise InputError(f"{begun * batch} evaluations are done already: {more}")
            run.write_config(config)
        is_last = begun >= total
        if is_last:
            publisher.publish(search)  # it may be older, where a run was killed at its very end
        bar.begin("", total * batch, begun * batch)
        stack.enter_context(bar)  # not before: a run that is refused shows its line alone
        evaluator, key = PipelinedEvaluator(pipeline, layouts), experiment.evaluation_key
        in_flight = AsyncEvaluation(algorithm, evaluator, key, total, begun, search)
        try:
            while not is_last:
                start = time.perf_counter()
                with bar.waiting_for("the search prepares the next population"):
                    in_flight.submit()
                evaluation = in_flight.wait()
                with undisturbed:
                    in_flight.collect(evaluation)
                    done, search = in_flight.done, in_flight.search
                    bar.note(str(publisher.log(done, search, evaluation, start)))
                    save_first(partial(publisher.save, done, search))
                    is_last = done == total or time.perf_counter() >= end
                    if done % config.checkpoint_every == 0 or is_last or publisher.has_time:
                        save_first(None)
                        publisher.save(done, search)
        except KeyboardInterrupt:  # in notebooks; programs end otherwise, see `interrupt`
            done, search = in_flight.done, in_flight.search
            arrays = [leaf for leaf in jax.tree.leaves(search) if isinstance(leaf, jax.Array)]
            # What `tell` has consumed in part cannot be read any more.
            whole = not any(array.is_deleted() for array in arrays)
            if done > begun and publisher.saved != done and whole:
                publisher.save(done, search)
            raise
    return run


def _announced(bar: Bar, what: str, function: Callable) -> Callable:
    """Have the bar name a function while jax traces it, which is when it is compiled next."""

    @wraps(function)
    def traced(*arguments: Any) -> Any:
        bar.wait_for(f"compiling and running the {what}")
        return function(*arguments)

    return traced


class Publisher:
    """Writes a search into its run directory."""

    def __init__(
        self,
        run: RunDirectory,
        experiment: Experiment,
        algorithm: Algorithm,
        settings: dict[str, Any],
    ) -> None:
        """Compile nothing yet; `settings` are what decides the run's result."""
        self._run, self._experiment, self._settings = run, experiment, settings
        self.saved = 0  # iteration after which this process has saved the search
        self._spent, self._last = 0.0, 0.0
        self._begun = self._since = time.perf_counter()
        self._algorithm, self._collect = algorithm, collector(algorithm)
        guide = experiment.pipeline.guide
        self._guide = guide and jax.jit(guide)

        def summarise(state: Any) -> tuple[jax.Array, jax.Array, int, jax.Array]:
            archive = algorithm.archive(state)
            best = jnp.where(archive.filled.any(), archive.objectives.max(), 0.0)
            return archive.qd_score, archive.filled.sum(), archive.filled.size, best

        self._summarise = jax.jit(summarise)

    def load(self, initial: Search) -> tuple[int, Search]:
        """Load the newest checkpoint, or `initial`, and the log up to it: later rows are repeated.

        Returns the number of iterations done, and the search after them. Raises InputError if
        there is a result but no checkpoint: a search from the start would replace it.
        """
        path = self._run.path
        done, search = load_newest(path, initial, self._settings)
        metrics, notes = self._run.read_metrics(salvage=True), self._run.read_notes(salvage=True)
        due = len(metrics) > self._run.config.checkpoint_every
        if not done and (due or (path / "archive.npz").exists()):
            raise InputError(f"{path}: no checkpoint to go on from, train in another folder")
        self._rows = [row for row in metrics if row.iteration <= done]
        self._notes = [note for note in notes if note["iteration"] <= done]
        self._seconds = self._rows[-1].seconds if self._rows else 0.0
        return done, search

    def log(self, iteration: int, search: Search, evaluation: Evaluation, start: float) -> Metrics:
        """Write the rows of an iteration that began at `start` (`time.perf_counter`).

        Raises InputError if none of its layouts could be repaired, and none before.
        """
        qd_score, filled, cells, best = map(float, self._summarise(search.state))  # this waits
        self._seconds += time.perf_counter() - start
        failed = np.asarray(evaluation.status) >= RepairStatus.IMPOSSIBLE
        # A simulator whose runs cannot congest has no such field.
        congested = np.asarray(getattr(evaluation.runs, "congested", False))
        evaluations, seconds = iteration * len(failed), round(self._seconds, 3)
        counts = int(failed.sum()), int(congested.sum())
        row = Metrics(iteration, evaluations, qd_score, filled / cells, best, seconds, *counts)
        self._rows.append(row)
        write_csv(self._run.path / METRICS, Metrics._fields, self._rows)
        notes = self._algorithm.notes(search.state)
        place = {"iteration": float(iteration), "evaluations": float(row.evaluations)}
        self._notes.append(place | {name: float(value) for name, value in notes.items()})
        if notes:
            table = [  # six digits: the numbers come from single precision
                ["" if math.isnan(value) else f"{value:g}" for value in note.values()]
                for note in self._notes
            ]
            write_csv(self._run.path / NOTES, list(self._notes[0]), table)
        if failed.all() and not filled:
            cure = "allow fewer shelves, narrower aisles or smaller racks"
            raise InputError(f"none of {failed.size} layouts could be repaired: {cure}")
        return row

    @property
    def has_time(self) -> bool:
        """Whether saving would stay a small share of the time, or has waited too long."""
        now = time.perf_counter()
        cheap = self._spent + self._last <= _SAVING_SHARE * (now - self._begun)
        return cheap or now - self._since > _LONGEST

    def save(self, iteration: int, search: Search) -> None:
        """Write a checkpoint, then the archive and its best layout."""
        begun = time.perf_counter()
        save_checkpoint(self._run.path, iteration, search, self._settings)
        self.publish(search)
        self._since = time.perf_counter()
        self._last = self._since - begun
        self.saved, self._spent = iteration, self._spent + self._last

    def publish(self, search: Search) -> None:
        """Write the archive and its best layout."""
        archive, domain = self._collect(search.state), self._experiment.pipeline.domain
        write_arrays(self._run.path / "archive.npz", archive, compressed=True)
        if len(archive["index"]) == 0:
            return
        row = best_row(archive, domain.tie_break)
        layout = archive["repaired"][row]
        measures = zip(self._experiment.measures, archive["measures"][row], strict=True)
        details = {
            **domain.details,
            "objective": float(archive["objective"][row]),
            "measures": {measure.name: float(value) for measure, value in measures},
            "similarity": float(archive["similarity"][row]),
        }
        costs = None
        if self._guide is not None:
            fixed = np.asarray(self._guide(archive["solution"][row], layout, jax.random.key(0)))
            costs = unscaled_costs(fixed, domain.drivable(layout))
        if domain.marks is not None:
            marks = domain.mark_cells(layout)
            details["marks"] = {name: list(cell) for name, cell in marks.items()}
        path = self._run.path / "best_layout.json"
        write_layout(path, layout, domain.tiles, domain.meanings, costs, **details)
