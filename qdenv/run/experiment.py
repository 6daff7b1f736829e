"""What a run searches: its pipeline, its axes, its algorithm, and what that algorithm observes."""

import dataclasses
import json
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax.traverse_util import flatten_dict

from qdenv.grid import parse
from qdenv.pipeline import Pipeline, evaluate, make_pipeline
from qdenv.run.config import WITHOUT_EFFECT, RunConfig, archive_axes, config_to_json, resolve
from qdenv.run.directory import find_start
from qdenv.search.base import Algorithm, Problem
from qdenv.search.registry import make_algorithm
from qdenv.types import Array, Encoding, Evaluation, InputError, Measure


class Experiment(NamedTuple):
    """One run's parts, built from its configuration and the parameters with which it begins."""

    measures: tuple[Measure, ...]  # axes of the archive, with the configured ranges
    pipeline: Pipeline  # the chain from parameters to evaluation, with its domain
    algorithm: Algorithm  # the search
    search_key: jax.Array  # key [] of the search's initial state
    # key [], iteration ``i`` is evaluated with ``fold_in(evaluation_key, i)``
    evaluation_key: jax.Array

    def settings(self, config: RunConfig) -> dict[str, Any]:
        """List what decides the result, by the names of config.json (``algorithm.sigma0``)."""
        axes = tuple((float(axis.low), float(axis.high), axis.cells) for axis in self.measures)
        content = config_to_json(dataclasses.replace(config, archive=axes))
        # As text and back: comparable with what a checkpoint holds.
        settings = flatten_dict(json.loads(json.dumps(content, default=np.generic.item)), sep=".")
        reads = self.pipeline.domain.reads()
        return {f"the {name} of checksum": reads[name] for name in reads} | {
            name: value
            for name, value in settings.items()
            if name.rpartition(".")[2] not in WITHOUT_EFFECT
        }


def make_experiment(
    config: RunConfig | str, start: np.ndarray | None = None, **settings: Any
) -> Experiment:
    """Build the parts of a run of `config`, a configuration or the name of a preset.

    `start` are the parameters from which the search begins, float [P]; those of the generator that
    the setting ``start`` names unless given. `settings` replace those of the configuration as in
    `train`, wherever they are nested: ``make_experiment("quick", backend="xla")``. Raises
    InputError if a name is unknown, or a setting is impossible.
    """
    if isinstance(config, str):
        from qdenv.configurations import find_preset  # which imports `run.config`

        config = find_preset(config)
    if settings:
        config, _ = resolve(config, settings)
    return build_experiment(config, start)


def build_experiment(config: RunConfig, start: np.ndarray | None = None) -> Experiment:
    """Build a run's parts of a whole configuration, see `make_experiment`."""
    if getattr(jax.config, "jax_enable_x64"):  # noqa: B009 (jax does not declare it)
        raise InputError("searches are in single precision: leave JAX_ENABLE_X64 out")
    pipeline = make_pipeline(config.evaluation, repair_seed=config.seed)
    measures = archive_axes(pipeline.domain.measures, config.archive)
    # Two keys, so that how a search draws its solutions cannot change how they are simulated.
    search_key, evaluation_key = jax.random.split(jax.random.key(config.seed))
    start = find_start(config) if start is None else start
    algorithm = make_algorithm(config.algorithm, problem_of(pipeline, measures), start)
    return Experiment(measures, pipeline, algorithm, search_key, evaluation_key)


def problem_of(pipeline: Pipeline, measures: tuple[Measure, ...]) -> Problem:
    """Make the search problem of a pipeline over these axes."""
    domain = pipeline.domain
    one = jax.ShapeDtypeStruct((1, pipeline.solution_size), np.float32)
    columns = jax.eval_shape(
        lambda solution, key: observed(evaluate(pipeline, solution, key)), one, jax.random.key(0)
    )
    usage = columns.pop("usage", None)  # observed, but not archived
    encoding = Encoding(
        domain.shape,
        len(domain.tiles),
        repairs=domain.rules is not None,
        usage=usage is not None,
        draw=lambda solutions: pipeline.grow(jnp.asarray(solutions)),
        choices=pipeline.choices,
        margin=domain.margin,
        around=parse(domain.config.around, domain.tiles) if domain.config.around else None,
    )
    extras = {name: np.zeros(leaf.shape[1:], leaf.dtype) for name, leaf in columns.items()}
    return Problem(pipeline.solution_size, measures, extras, encoding)


def observed(evaluation: Evaluation) -> dict[str, Array]:
    """Select what an algorithm observes of an evaluation beside its score, all of it archived.

    Both layouts, similarity, repair status, and every number per run [B, S] of the simulator but
    congested_at. Where that draws a map of how cells are used, also ``usage``, which is not
    archived: the share of agent-steps on each cell, float32 [B, H, W], averaged over the runs.
    """
    columns = {
        name: leaf
        for name, leaf in evaluation.runs._asdict().items()
        # Where congestion ends a run, congested_at equals end_timestep.
        if leaf is not None and len(leaf.shape) == 2 and name != "congested_at"
    }
    for name in ("unrepaired", "repaired", "similarity", "status"):
        columns[name] = getattr(evaluation, name)
    usage = getattr(evaluation.runs, "usage", None)
    return columns if usage is None else columns | {"usage": usage.mean(axis=1)}


def make_iteration(experiment: Experiment) -> Callable[[Any, jax.Array], Any]:
    """Make one whole iteration of an `experiment` as one traceable function.

    Under `jax.jit` the repair is the only thing that leaves the device (where the planner's backend
    is XLA); under `lax.scan` a run is one program. `train` runs the same iteration in parts
    instead, so that repairs and simulations overlap. Returns the function (state, iteration int32
    []) -> state; the first state is ``experiment.algorithm.init(experiment.search_key)``. Raises
    InputError if the algorithm draws populations ahead, which takes several at once.
    """
    if experiment.algorithm.ahead:
        raise InputError("a whole iteration as one function draws nothing ahead: leave ahead at 0")

    def iterate(state: Any, iteration: jax.Array) -> Any:
        solutions, state = experiment.algorithm.ask(state)
        key = jax.random.fold_in(experiment.evaluation_key, iteration)
        evaluation = evaluate(experiment.pipeline, solutions, key)
        return experiment.algorithm.tell(state, solutions, evaluation.score, observed(evaluation))

    return iterate
