"""Benchmark of the search on its own: milliseconds per iteration, pyribs beside it if installed."""

import importlib.util
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from qdenv.io.files import write_json
from qdenv.search.archive import GridArchive
from qdenv.search.base import Problem
from qdenv.search.cma_mae import CmaMaeConfig, cma_mae
from qdenv.search.settings import Strategy
from qdenv.types import Measure, Score

GRID = (Measure("x", -1, 1, 100), Measure("y", -1, 1, 100))
MAZE = (Measure("walls", 0, 256, 256), Measure("path length", 0, 648, 162))
PYRIBS_NAMES = {"full": "cma_es", "iso": "cma_es", "sep": "sep_cma_es", "lm_ma": "lm_ma_es"}


class Case(NamedTuple):
    """One search to time."""

    name: str
    dim: int
    emitters: int
    batch: int
    strategy: Strategy
    pyribs_iterations: int  # 0: too slow to be worth it


CASES = (
    Case("paper", 2_051, 5, 10, "iso", 5),
    Case("paper", 2_051, 5, 10, "sep", 50),
    Case("kernels 3,3,3", 11_011, 5, 10, "iso", 0),
    Case("kernels 3,3,3", 11_011, 5, 10, "sep", 50),
    Case("sphere", 100, 15, 36, "full", 100),
    Case("sphere", 100, 15, 36, "iso", 100),
    Case("sphere", 100, 15, 36, "sep", 100),
    Case("sphere", 100, 15, 36, "lm_ma", 100),
)


def run(
    iterations: int = 100,
    only: str = "",
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
) -> dict[str, Any]:
    """Time CMA-MAE with both archives (100 x 100) and one large insertion.

    Ask and tell only: the evaluation, a few array operations, is not counted. CPU time is of all
    threads; compilation is left out.

    Args:
        iterations: timed iterations of ours.
        only: run the cases whose name or strategy contains this.
        json_file: where to write the result.
    """
    pyribs = importlib.util.find_spec("ribs") is not None
    rows = []
    for case in CASES:
        if only not in f"{case.name} {case.strategy}":
            continue
        row = {**case._asdict(), "qdenv": time_ours(case, iterations)}
        del row["pyribs_iterations"]
        if pyribs and case.pyribs_iterations:
            row["pyribs"] = time_pyribs(case)
        rows.append(row)
        print(json.dumps(row), flush=True)
    result = {"device": jax.devices()[0].device_kind, "searches": rows}
    if not only:
        result["insertion"] = {"cells": 41_472, "batch": 1_000, "qdenv": time_insertion(pyribs)}
        print(json.dumps(result["insertion"]), flush=True)
    if json_file:
        write_json(json_file, result)
    return result


def evaluate(solutions: Any, numbers: Any) -> tuple[Any, Any]:
    """Score cheaply: the objective is a bowl, the measures are the means of both halves."""
    objective = 1 - numbers.square(solutions - 0.1).mean(axis=1)
    half = solutions.shape[1] // 2
    means = [solutions[:, :half].mean(axis=1), solutions[:, half:].mean(axis=1)]
    return objective, numbers.stack(means, axis=1) * half**0.5


def stopwatch(work: Callable[[], Any], times: int) -> dict[str, float]:
    """Measure CPU and wall milliseconds of one of several calls."""
    wall, cpu = time.perf_counter(), time.process_time()
    for _ in range(times):
        last = work()
    jax.block_until_ready(last)
    spent = time.process_time() - cpu, time.perf_counter() - wall
    return {
        name: round(1000 * seconds / times, 3)
        for name, seconds in zip(("cpu_ms", "wall_ms"), spent, strict=True)
    }


def time_ours(case: Case, iterations: int) -> dict[str, float]:
    """Time ask and tell as two jitted calls per iteration, the state donated to both."""
    config = CmaMaeConfig(case.emitters, case.batch, strategy=case.strategy)
    algorithm = cma_mae(config, Problem(case.dim, GRID))
    ask = jax.jit(algorithm.ask, donate_argnums=0)
    tell = jax.jit(algorithm.tell, donate_argnums=0)

    @jax.jit
    def score(solutions: Any) -> Score:
        objective, measures = evaluate(solutions, jnp)
        return Score(objective, objective, measures, jnp.ones(len(solutions), bool))

    state = algorithm.init(jax.random.key(0))
    spent = []
    for iteration in range(iterations + 3):
        start = time.process_time(), time.perf_counter()
        solutions, state = jax.block_until_ready(ask(state))
        asked = time.process_time(), time.perf_counter()
        scores = jax.block_until_ready(score(solutions))
        scored = time.process_time(), time.perf_counter()
        state = jax.block_until_ready(tell(state, solutions, scores, {}))
        told = time.process_time(), time.perf_counter()
        if iteration >= 3:  # the first ones compile
            spent.append(
                [a - b + d - c for a, b, c, d in zip(asked, start, scored, told, strict=True)]
            )
    cpu, wall = 1000 * np.mean(spent, axis=0)
    return {"cpu_ms": round(float(cpu), 3), "wall_ms": round(float(wall), 3)}


def time_pyribs(case: Case) -> dict[str, float]:
    """Time ask and tell of a pyribs scheduler with the same settings, in float32."""
    from ribs.archives import GridArchive as RibsArchive
    from ribs.emitters import EvolutionStrategyEmitter
    from ribs.schedulers import Scheduler

    grid = {
        "solution_dim": case.dim,
        "dims": [axis.cells for axis in GRID],
        "ranges": [(axis.low, axis.high) for axis in GRID],
        "dtype": np.float32,
    }
    archive = RibsArchive(**grid, learning_rate=0.01, threshold_min=0.0)
    emitters = [
        EvolutionStrategyEmitter(
            archive,
            x0=np.zeros(case.dim),
            sigma0=0.2,
            ranker="imp",
            es=PYRIBS_NAMES[case.strategy],
            selection_rule="mu",
            restart_rule="no_improvement",
            batch_size=case.batch,
            seed=seed,
        )
        for seed in range(case.emitters)
    ]
    scheduler = Scheduler(archive, emitters, result_archive=RibsArchive(**grid))
    scheduler.tell(*evaluate(scheduler.ask(), np))  # numba compiles here
    solutions = {}

    def iteration() -> None:
        solutions["now"] = scheduler.ask()
        scheduler.tell(*evaluate(solutions["now"], np))

    return stopwatch(iteration, case.pyribs_iterations)


def time_insertion(pyribs: bool) -> dict[str, Any]:
    """Time adding 1,000 solutions of 100 parameters to the maze's 256 x 162 cells."""
    rng = np.random.default_rng(0)
    batch = (
        rng.normal(size=(1000, 100)).astype(np.float32),
        rng.normal(size=1000).astype(np.float32),
        rng.uniform(0, (256, 648), (1000, 2)).astype(np.float32),
    )
    insert = jax.jit(lambda archive, *rows: archive.insert(*rows)[0], donate_argnums=0)
    place = {"archive": insert(GridArchive.empty(jnp.zeros(100), MAZE), *batch)}

    def once() -> Any:
        place["archive"] = insert(place["archive"], *batch)
        return place["archive"]

    once()
    spent: dict[str, Any] = stopwatch(once, 50)
    if pyribs:
        from ribs.archives import GridArchive as RibsArchive

        dims, ranges = [a.cells for a in MAZE], [(a.low, a.high) for a in MAZE]
        archive = RibsArchive(solution_dim=100, dims=dims, ranges=ranges, dtype=np.float32)
        spent["pyribs"] = stopwatch(lambda: archive.add(*batch) and None, 50)
    return spent
