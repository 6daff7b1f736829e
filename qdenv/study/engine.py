"""Simulations of one layout over seeds, in threads: what every study of traffic runs on."""

import functools
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any, NamedTuple

import jax
import numpy as np

from qdenv import devices
from qdenv.grid import NUM_MOVES
from qdenv.progress import Progress, silent
from qdenv.simulation.mapf import fleet
from qdenv.simulation.mapf.host.run import runs_under_way
from qdenv.simulation.mapf.metrics import Recording
from qdenv.simulation.mapf.settings import PLANNERS
from qdenv.study.options import fleet_tasks
from qdenv.types import Floor, TaskRule, Traffic

_POLL_SECONDS = 0.2  # between two reports of the progress


class Simulated(NamedTuple):
    """The runs of one layout."""

    seeds: tuple[int, ...]  # one per run
    runs: list[Traffic]  # `Traffic` of numpy values
    readings: list[Any]  # what the reader returned for each run; empty without a reader
    cpu_seconds: float  # of simulating all runs, without compiling and reading
    compile_seconds: float  # CPU seconds of compiling; about 0 for a cached program


def run_seeds(
    floor: Floor | np.ndarray,
    tasks: TaskRule | None,
    config: fleet.FleetConfig,
    seeds: Sequence[int],
    agents: int | None = None,
    read: Callable[[int, Traffic, Recording], Any] | None = None,
    threads: int | None = None,
    progress: Progress = silent,
) -> Simulated:
    """Simulate a floor, or a layout (int8 [H, W]) alone, once per seed, on all cores.

    Layouts of one size share a compiled program; so do numbers of `agents`, at most
    ``config.agents``, the default. `read` is called with each seed, its run and
    its recording, which is dropped afterwards: all recordings together may not fit into memory.
    Without it nothing is recorded. `threads` is the number of runs at a time, None for that of the
    cores. Raises InputError if the domain has no fleet, or the layout does not suit it.
    """
    layout, costs = Floor.of(floor)
    count = config.agents if agents is None else agents
    tasks = fleet_tasks(layout, tasks, count)
    begin, known = time.process_time(), _program.cache_info().misses
    settings = tasks, config, layout.shape, read is not None, costs is not None
    prepare, run, on_host = _program(*settings)
    new = _program.cache_info().misses > known
    if new:
        progress("compiling the simulator", -1, "")
    world = prepare(layout, *([] if costs is None else [costs]))
    if on_host and new:
        run(world, 0, 0)  # a run without agents loads or compiles the host's code
    compiled = time.process_time()

    def one(seed: int) -> tuple[Traffic, Any, float]:
        traffic, recording = jax.tree.map(np.asarray, run(world, seed, count))
        since = time.thread_time()
        reading = read(seed, traffic, recording) if read else None
        return traffic, reading, time.thread_time() - since

    # A compiled call leaves the interpreter lock, so threads use all cores.
    pool = ThreadPoolExecutor(threads or devices.threads(on_host))
    try:
        futures = [pool.submit(one, seed) for seed in seeds]
        share, left = 0.0, set(futures)
        while left:
            done, left = wait(left, timeout=_POLL_SECONDS)
            for future in done:
                future.result()  # raises at once what a run raised
            ended = len(futures) - len(left)
            # A run that has just ended is for a moment counted neither as running nor as ended,
            # and progress must not go back.
            driven = sum(int(run.counters.time) for run in list(runs_under_way.values()))
            share = max(share, (ended + driven / config.timesteps) / len(futures))
            note = f"run {min(ended + 1, len(futures))} of {len(futures)}"
            progress("simulating", min(share, 1.0), note)
        results = [future.result() for future in futures]
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
    return Simulated(
        seeds=tuple(seeds),
        runs=[traffic for traffic, _, _ in results],
        readings=[reading for _, reading, _ in results if read],
        # The process's time, because drivers also work in threads of their own.
        cpu_seconds=time.process_time() - compiled - sum(spent for _, _, spent in results),
        compile_seconds=compiled - begin,
    )


# A study of several sizes and capacities compiles each program once.
@functools.lru_cache(maxsize=32)
def _program(
    tasks: TaskRule, config: fleet.FleetConfig, shape: tuple[int, int], record: bool, priced: bool
) -> tuple[Callable, Callable, bool]:
    """Compile the simulation of layouts of one size; `priced`: moves have fixed costs.

    Return (layout, and costs if `priced`) -> world; (world, seed, number of agents) -> traffic and
    recording; and whether the latter is compiled code of the host.
    """
    inputs = [jax.ShapeDtypeStruct(shape, np.int8)]
    if priced:
        inputs.append(jax.ShapeDtypeStruct((NUM_MOVES, *shape), np.int32))
    prepare = jax.jit(lambda layout, *costs: fleet.prepare(layout, tasks, config, *costs))
    run = fleet.compile_runs(jax.eval_shape(prepare, *inputs), config, record)
    compiled = prepare.lower(*inputs).compile()
    if not PLANNERS.make(config.planner).on_host:
        return compiled, run, False
    return lambda *inputs: jax.tree.map(np.asarray, compiled(*inputs)), run, True
