"""Benchmarks of whole searches: where the time goes, threads beside a cluster."""

import heapq
import os
import random
import signal
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import wait
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jax.random import fold_in

import qdenv
from experiments.benchmarks.common import Row, Stopwatch, save, show
from qdenv.pipeline import PipelinedEvaluator
from qdenv.ranges import PositiveInt
from qdenv.run.evaluate import Threads
from qdenv.run.executors import ClusterExecutor, Execution, Task
from qdenv.run.experiment import observed
from qdenv.search.base import growing

CLUSTER = {"threads_per_worker": 1, "memory_limit": 0, "dashboard_address": None}


def pipeline(
    preset: str = "warehouse-even",
    iterations: PositiveInt = 3,
    batch: int = 0,
    seed: int = 0,
    json: Path | None = None,
) -> Row:
    """Time some iterations of a search, then one more stage by stage.

    Compilation happens in an iteration of its own. `JAX_PLATFORMS=cpu` keeps an accelerator out.

    Args:
        preset: a named configuration.
        iterations: number of timed iterations, whose repairs and simulations overlap.
        batch: solutions of each emitter; 0: the preset's.
        seed: of the search.
        json: file of the result.
    """
    options: Row = {"batch": batch} if batch else {}
    experiment = qdenv.make_experiment(preset, seed=seed, **options)
    if experiment.pipeline.pool is None:
        raise qdenv.InputError(f"nothing is repaired in {preset}: choose another preset")
    evaluator = PipelinedEvaluator(experiment.pipeline, Threads(experiment.pipeline))
    algorithm = growing(experiment.algorithm)

    def step(state: Any, number: int) -> Any:
        solutions, state = algorithm.ask(state)
        evaluation = evaluator.begin(solutions, fold_in(experiment.evaluation_key, number))()
        return algorithm.tell(state, solutions, evaluation.score, observed(evaluation))

    first, loop = Stopwatch(), Stopwatch()
    with first:
        state = jax.block_until_ready(step(algorithm.init(experiment.search_key), 0))
    with loop:
        for number in range(iterations):
            state = step(state, number + 1)
        jax.block_until_ready(state)
    stages = time_stages(experiment._replace(algorithm=algorithm), state)
    evaluations = iterations * experiment.algorithm.batch_size
    row = {
        "preset": preset,
        "evaluations": evaluations,
        "per_minute": 60 * evaluations / loop.wall,
        "cpu_s_each": loop.cpu / evaluations,
        "first_cpu_s": first.cpu,
        "first_wall_s": first.wall,
    }
    return save(json, search=show("search", [row]), stages=show("stages", stages))


def time_stages(experiment: Any, state: Any) -> list[Row]:
    """Time an iteration stage by stage, without compilation."""
    chain, algorithm = experiment.pipeline, experiment.algorithm
    watches: dict[str, Stopwatch] = {}

    def timed(name: str, function: Callable, *arguments: Any) -> Any:
        with watches.setdefault(name, Stopwatch()):
            return jax.block_until_ready(function(*arguments))

    def compiled(name: str, function: Callable, *arguments: Any) -> Any:
        return timed(name, jax.jit(function).lower(*arguments).compile(), *arguments)

    solutions, state = timed("search", algorithm.ask, state)
    unrepaired = np.asarray(compiled("NCA", chain.grow, solutions))
    # Another seed than the run's: the pool remembers its repairs.
    repair = timed("repair", chain.pool.repair, unrepaired, chain.repair_seed + 1)
    indices = np.arange(len(unrepaired))
    runs = compiled("simulate", chain.simulate, repair.layout, indices, experiment.search_key)
    evaluation = compiled("score", chain.score, unrepaired, repair.layout, repair.status, runs)
    timed("search", algorithm.tell, state, solutions, evaluation.score, observed(evaluation))
    total = sum(watch.cpu for watch in watches.values())
    return [
        {"stage": name, "cpu_s": watch.cpu, "percent": 100 * watch.cpu / total}
        for name, watch in watches.items()
    ]


def executors(
    preset: str = "quick",
    evaluations: int = 300,
    workers: int = 2,
    kills: int = 20,
    simulated: int = 64,
    batch: int = 50,
    ahead: int = 2,
    seed: int = 0,
    json: Path | None = None,
) -> Row:
    """Search with threads, with a cluster on this machine, and while its workers are killed.

    Then a cluster of many workers whose tasks sleep as long as layouts of size S take.

    Args:
        preset: a named configuration.
        evaluations: of each search; 0 for none.
        workers: processes of the cluster, and threads.
        kills: workers that are killed at random moments of the third search; 0 for none.
        simulated: workers of the cluster that sleeps; 0 for none.
        batch: tasks of each of its populations.
        ahead: populations in flight beyond the first, to compare with none.
        seed: of the search and of the kills.
        json: file of the result.
    """
    tables = {}
    if evaluations:
        config = replace(qdenv.find_preset(preset), evaluations=evaluations, seed=seed)
        tables["searches"] = show("searches", compare_executors(config, workers, kills))
    if simulated:
        rows = (sleep(simulated, batch, seed, number) for number in sorted({0, ahead}))
        tables["sleeping"] = show("a cluster that sleeps", rows)
    return save(json, **tables)


def compare_executors(config: Any, workers: int, kills: int) -> Iterator[Row]:
    """Search with threads, with a cluster, and with a cluster whose workers are killed."""

    def row(name: str, run: Any, killed: int = 0) -> Row:
        metrics = run.read_metrics()
        half, last = metrics[(len(metrics) - 1) // 2], metrics[-1]  # the first half compiles
        seconds = last.seconds - half.seconds or float("nan")  # of a search of one iteration
        rate = (last.evaluations - half.evaluations) / seconds
        same = contents(run) == contents(threads)
        return {"executor": name, "per_second": rate, "killed": killed, "same_archive": same}

    def contents(run: Any) -> tuple[bytes, list]:
        metrics = [metric._replace(seconds=0.0) for metric in run.read_metrics()]
        return (run.path / "archive.npz").read_bytes(), metrics

    with tempfile.TemporaryDirectory() as folder:
        train = partial(train_and_kill, config, workers)
        threads = qdenv.train(config, f"{folder}/threads", False, Execution(workers=workers))
        yield row("threads", threads)
        yield row("Dask", *train(Path(folder, "dask"), 0, 0.0))
        if kills:
            pause = threads.read_metrics()[-1].seconds / kills
            yield row("Dask, workers killed", *train(Path(folder, "killed"), kills, pause))


def train_and_kill(
    config: Any, workers: int, path: Path, kills: int, pause: float
) -> tuple[Any, int]:
    """Search on a cluster while its workers are killed; return the run and the number of kills."""
    from distributed import Client, LocalCluster

    rng, killed, finished = random.Random(config.seed), [0], threading.Event()

    def kill(address: str) -> None:
        with Client(address) as client:
            while killed[0] < kills and not finished.wait(rng.uniform(0.5, 1.5) * pause):
                pids = [*client.run(os.getpid, on_error="ignore").values()]
                if pids:
                    os.kill(rng.choice(pids), signal.SIGKILL)
                    killed[0] += 1

    with LocalCluster(n_workers=workers, **CLUSTER) as cluster:
        killer = threading.Thread(target=kill, args=(cluster.scheduler_address,))
        killer.start()
        execution = Execution("dask", scheduler=cluster.scheduler_address)
        run = qdenv.train(config, path, False, execution)
        finished.set()
        killer.join()
    return run, killed[0]


def sleep(workers: int, batch: int, seed: int, ahead: int) -> Row:
    """Measure the share of time that a cluster's workers sleep, each task instead of an evaluation.

    The ideal is a share that no scheduler exceeds, as an old population waits for its slowest
    layout.
    """
    from distributed import Client, LocalCluster

    # Seconds of 20 populations at size S: about 2 with a spread of a quarter.
    lengths = np.random.default_rng(seed).gamma(16, 2 / 16, (20, batch))
    with (
        LocalCluster(n_workers=workers, processes=False, **CLUSTER) as cluster,
        Client(cluster) as client,
    ):
        executor, in_flight = ClusterExecutor(client), deque[list[Task]]()
        wait([executor.submit(time.sleep, 0.01) for _ in range(workers)])
        with Stopwatch() as watch:
            for population in lengths.tolist():
                in_flight.append([executor.submit(time.sleep, length) for length in population])
                if len(in_flight) > ahead:
                    wait(in_flight.popleft())
            for tasks in in_flight:
                wait(tasks)
        executor.shutdown()
    total = float(lengths.sum()) / workers
    name, ideal = f"{workers} workers, {ahead} ahead", shortest_time(lengths, workers, ahead)
    return {"cluster": name, "busy": total / watch.wall, "ideal": total / ideal}


def shortest_time(lengths: np.ndarray, workers: int, ahead: int) -> float:
    """Return the seconds that workers need if each takes the next task as soon as it is free.

    `lengths` are the seconds of each task, float [populations, B]; a population begins when all but
    `ahead` populations before it are finished.
    """
    free, finished = [0.0] * workers, [0.0] * (ahead + 1)
    for population in lengths.tolist():
        ends = [finished[-1]]  # populations finish in order
        for length in population:
            ends.append(max(heapq.heappop(free), finished[-ahead - 1]) + length)
            heapq.heappush(free, ends[-1])
        finished.append(max(ends))
    return finished[-1]
