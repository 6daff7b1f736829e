"""Benchmark of the whole chain: evaluations per minute of a preset, and where the time goes."""

import json
import resource
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import jax
import numpy as np
import tyro

from qdenv.io.files import write_json
from qdenv.pipeline import PipelinedEvaluator
from qdenv.presets import find_preset
from qdenv.run.executors.layouts import Threads
from qdenv.run.loop import Experiment, make_experiment
from qdenv.run.problem import seen
from qdenv.search.base import growing
from qdenv.types import InputError


def run(
    preset: str = "warehouse-even",
    iterations: int = 3,
    seed: int = 0,
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
) -> dict[str, Any]:
    """Search for some iterations, then take one more apart stage by stage.

    Compilation happens in an iteration of its own and is reported apart.

    Args:
        preset: a named configuration.
        iterations: timed iterations of the pipelined loop.
        seed: of the search.
        json_file: where to write the result.
    """
    experiment = make_experiment(replace(find_preset(preset), seed=seed))
    evaluator = PipelinedEvaluator(experiment.pipeline, Threads(experiment.pipeline))
    algorithm = growing(experiment.algorithm)
    state = algorithm.init(experiment.search_key)

    def step(state: Any, number: int) -> Any:
        solutions, state = algorithm.ask(state)
        evaluation = evaluator(solutions, jax.random.fold_in(experiment.evaluation_key, number))
        return algorithm.tell(state, solutions, evaluation.score, seen(evaluation))

    def repeat(state: Any) -> Any:
        for number in range(iterations):
            state = step(state, number + 1)
        return jax.block_until_ready(state)

    # Compilation goes into an iteration of its own, so that the others pay for the search alone.
    first = timed(lambda: jax.block_until_ready(step(state, 0)))
    state = first.pop("result")
    loop = timed(lambda: repeat(state))
    state = loop.pop("result")
    batch = experiment.algorithm.batch_size
    result = {
        "preset": preset,
        "evaluations": iterations * batch,
        "evaluations_per_minute": 60 * iterations * batch / loop["wall"],
        "cpu_seconds_per_evaluation": loop["cpu"] / (iterations * batch),
        "first_iteration_with_compilation": first,
        "peak_memory_gb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
        "cpu_share_percent": split(experiment._replace(algorithm=algorithm), state),
    }
    print(json.dumps(result, indent=1))
    if json_file:
        write_json(json_file, result)
    return result


def split(experiment: Experiment, state: Any) -> dict[str, float]:
    """Run an iteration stage by stage, compiled beforehand: shares of the CPU seconds, per cent.

    Args:
        experiment: with the algorithm as the loop before ran it.
        state: of the search.

    Raises:
        InputError: nothing is repaired in this domain.
    """
    pipeline, algorithm = experiment.pipeline, experiment.algorithm
    spent: defaultdict[str, float] = defaultdict(float)

    def clock(name: str, work: Callable, *given: Any) -> Any:
        measured = timed(lambda: jax.block_until_ready(work(*given)))
        spent[name] += measured["cpu"]
        return measured["result"]

    def clock_compiled(name: str, function: Callable, *given: Any) -> Any:
        return clock(name, jax.jit(function).lower(*given).compile(), *given)

    solutions, state = clock("search", algorithm.ask, state)
    unrepaired = np.asarray(clock_compiled("NCA", pipeline.grow, solutions))
    if pipeline.pool is None:
        raise InputError("nothing is repaired in this domain: take a preset of another one")
    # Another repair seed than the run's, so that no repair is remembered.
    repair = clock("repair", pipeline.pool.repair, unrepaired, pipeline.repair_seed + 1)
    indices = np.arange(len(unrepaired))
    runs = clock_compiled(
        "simulate", pipeline.simulate, repair.layout, indices, experiment.search_key
    )
    evaluation = clock_compiled(
        "score", pipeline.score, unrepaired, repair.layout, repair.status, runs
    )
    clock("search", algorithm.tell, state, solutions, evaluation.score, seen(evaluation))
    total = sum(spent.values())
    return {name: round(100 * seconds / total, 2) for name, seconds in spent.items()}


def timed(work: Callable[[], Any]) -> dict[str, Any]:
    """Measure wall and CPU seconds of all threads."""
    wall, cpu = time.perf_counter(), time.process_time()
    result = work()
    return {
        "wall": time.perf_counter() - wall,
        "cpu": time.process_time() - cpu,
        "result": result,
    }
