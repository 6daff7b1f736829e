"""Benchmark of executors: a cluster against threads, workers that are killed, many workers."""

import json
import os
import random
import signal
import tempfile
import threading
import time
from collections import deque
from concurrent.futures import wait
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from qdenv.io.files import write_json
from qdenv.presets import find_preset
from qdenv.run import loop
from qdenv.run.directory import RunDirectory
from qdenv.run.executors.base import Execution
from qdenv.run.executors.dask import ClusterExecutor, Task


@dataclass(frozen=True)
class Options:
    """What to run."""

    preset: str = "quick"  # a named configuration
    evaluations: int = 300  # of each search
    workers: int = 2  # processes of the cluster, and threads to compare with
    kills: int = 20  # workers that are killed at random moments of the third search
    simulated: int = 64  # workers of the cluster that sleeps
    batch: int = 50  # layouts of its populations
    ahead: int = 2  # populations asked ahead, to compare with none
    seed: int = 0  # of the search, and of who is killed when


def run(
    options: Annotated[Options, tyro.conf.arg(name="")],
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
) -> dict[str, Any]:
    """Search with threads, with a cluster on this machine, and once more while workers are killed.

    Then a cluster of many workers whose tasks sleep as long as layouts of size S take.

    Args:
        options: what to run.
        json_file: where to write the result.
    """
    result: dict[str, Any] = asdict(options)
    if options.evaluations:
        result |= compare(options)
    if options.simulated:
        ways = (0, options.ahead) if options.ahead else (0,)
        given = options.simulated, options.batch, options.seed
        result["sleeping"] = [sleep_through(*given, ahead) for ahead in ways]
    print(json.dumps(result, indent=1))
    if json_file:
        write_json(json_file, result)
    return result


def compare(options: Options) -> dict[str, Any]:
    """Search with threads, with a cluster, and with a cluster whose workers are killed."""
    config = find_preset(options.preset)
    config = replace(config, evaluations=options.evaluations, seed=options.seed)
    workers = options.workers
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        threads = loop.train(config, home / "threads", False, Execution(workers=workers))
        dask = loop.train(config, home / "dask", False, Execution("dask", workers=workers))
        result: dict[str, Any] = {
            "evaluations_per_second": {"threads": speed(threads), "dask": speed(dask)},
            "same_archive": alike(threads, dask),
        }
        if options.kills:
            result |= survive(config, home / "killed", workers, options.kills, threads)
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


def sleep_through(
    workers: int, batch: int, seed: int, ahead: int, populations: int = 20
) -> dict[str, Any]:
    """Let a cluster of many workers sleep instead of evaluating layouts.

    Returns:
        workers, batch, ahead, and busy: the share of the workers' time that is spent sleeping;
        ideal is what no scheduler could exceed, as an old population waits for its slowest layout.
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
        executor = ClusterExecutor(client)
        wait([executor.submit(time.sleep, 0.01) for _ in range(workers)])
        begun, under_way = time.perf_counter(), deque[list[Task]]()
        for population in lengths.tolist():
            under_way.append([executor.submit(time.sleep, length) for length in population])
            if len(under_way) > ahead:
                wait(under_way.popleft())
        for rest in under_way:
            wait(rest)
        spent = time.perf_counter() - begun
        executor.shutdown()
    return {
        "workers": workers,
        "batch": batch,
        "ahead": ahead,
        "busy": lengths.sum() / (workers * spent),
        "ideal": lengths.sum() / (workers * shortest_time(lengths, workers, ahead)),
    }


def shortest_time(lengths: np.ndarray, workers: int, ahead: int) -> float:
    """Seconds that so many workers need, each taking the next task when it is free.

    Args:
        lengths: float [populations, B], seconds of each task.
        workers: how many.
        ahead: a population begins when all but so many before it are done.
    """
    free, over = np.zeros(workers), np.zeros(len(lengths))
    for number, population in enumerate(lengths):
        begins = over[number - ahead - 1] if number > ahead else 0.0
        for length in population:
            first = free.argmin()
            free[first] = max(free[first], begins) + length
            over[number] = max(over[number], free[first])
        over[number] = over[: number + 1].max()  # they are told in order
    return float(over.max())
