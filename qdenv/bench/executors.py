"""Benchmark of executors: a cluster against threads, workers that are killed, many workers."""

import json
import os
import random
import signal
import tempfile
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from qdenv.files import write_json
from qdenv.presets import find_preset
from qdenv.training import loop
from qdenv.training.executors.choosing import Execution
from qdenv.training.executors.workers import Workers
from qdenv.training.records import RunDirectory


def run(
    preset: str = "quick",
    evaluations: int = 300,
    workers: int = 2,
    kills: int = 20,
    simulated: int = 64,
    batch: int = 50,
    seed: int = 0,
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
) -> dict[str, Any]:
    """Search with threads, with a cluster on this machine, and once more while workers are killed.

    Then a cluster of many workers whose tasks sleep as long as layouts took here.

    Args:
        preset: a named configuration.
        evaluations: of each search.
        workers: processes of the cluster, and threads to compare with.
        kills: workers that are killed at random moments of the third search.
        simulated: workers of the cluster that sleeps.
        batch: layouts of its populations.
        seed: of the search, and of who is killed when.
        json_file: where to write the result.
    """
    config = replace(find_preset(preset), evaluations=evaluations, seed=seed)
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        threads = loop.train(config, home / "threads", False, Execution(workers=workers))
        dask = loop.train(config, home / "dask", False, Execution("dask", workers=workers))
        result: dict[str, Any] = {
            "preset": preset,
            "evaluations": evaluations,
            "workers": workers,
            "evaluations_per_second": {"threads": speed(threads), "dask": speed(dask)},
            "same_archive": alike(threads, dask),
        }
        if kills:
            result |= survive(config, home / "killed", workers, kills, threads)
    if simulated:
        result["simulated"] = sleep_through(simulated, batch, seed)
    print(json.dumps(result, indent=1))
    if json_file:
        write_json(json_file, result)
    return result


def speed(run: RunDirectory) -> float:
    """Evaluations per second of the second half of a run, when all is compiled."""
    rows = run.read_metrics()
    half, last = rows[len(rows) // 2], rows[-1]
    return (last.evaluations - half.evaluations) / (last.seconds - half.seconds)


def alike(one: RunDirectory, other: RunDirectory) -> bool:
    """Tell whether two runs have the same archive and, but for seconds, the same metrics."""
    timeless = [[row._replace(seconds=0.0) for row in run.read_metrics()] for run in (one, other)]
    files = [(run.path / "archive.npz").read_bytes() for run in (one, other)]
    return files[0] == files[1] and timeless[0] == timeless[1]


def survive(
    config: Any, path: Path, workers: int, kills: int, whole: RunDirectory
) -> dict[str, Any]:
    """Search on a cluster whose workers are killed, evenly over the time of the search."""
    from distributed import Client, LocalCluster

    chance, killed, over = random.Random(config.seed), [0], threading.Event()
    pause = whole.read_metrics()[-1].seconds / kills

    def hunt(address: str) -> None:
        with Client(address) as client:
            while killed[0] < kills and not over.wait(chance.uniform(0.5, 1.5) * pause):
                pids = [*client.run(os.getpid, on_error="ignore").values()]
                if pids:
                    os.kill(chance.choice(pids), signal.SIGKILL)
                    killed[0] += 1

    with LocalCluster(
        n_workers=workers, threads_per_worker=1, memory_limit=0, dashboard_address=None
    ) as cluster:
        hunter = threading.Thread(target=hunt, args=(cluster.scheduler_address,))
        hunter.start()
        execution = Execution("dask", scheduler=cluster.scheduler_address)
        run = loop.train(config, path, False, execution)
        over.set()
        hunter.join()
    return {"killed": killed[0], "same_archive_after_kills": alike(run, whole)}


def sleep_through(workers: int, batch: int, seed: int, populations: int = 5) -> dict[str, Any]:
    """Let a cluster of many workers sleep instead of evaluating layouts.

    Returns:
        workers, batch, and busy: the share of the workers' time that is spent sleeping; ideal is
        what no scheduler could exceed, as a population waits for its slowest layout.
    """
    from distributed import Client, LocalCluster

    # Seconds of evaluations at size S: gamma-distributed about 2 with a spread of a quarter.
    lengths = np.random.default_rng(seed).gamma(16, 2 / 16, (populations, batch))
    with (
        LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            memory_limit=0,  # they share one process
            processes=False,
            dashboard_address=None,
        ) as cluster,
        Client(cluster) as client,
    ):
        sleepers = Workers(client, time.sleep)
        sleepers.map([(0.01,)] * workers)
        begun = time.perf_counter()
        for population in lengths.tolist():
            sleepers.map([(length,) for length in population])
        spent = time.perf_counter() - begun
    best = sum(shortest_time(population, workers) for population in lengths)
    return {
        "workers": workers,
        "batch": batch,
        "busy": lengths.sum() / (workers * spent),
        "ideal": lengths.sum() / (workers * best),
    }


def shortest_time(lengths: np.ndarray, workers: int) -> float:
    """Seconds that so many workers need, each taking the next task when it is free."""
    free = np.zeros(workers)
    for length in lengths:
        free[free.argmin()] += length
    return float(free.max())
