"""How studies tell how far they are."""

import functools
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import jax
import numpy as np

from qdenv import devices
from qdenv.progress import Progress, silent
from qdenv.simulate.mapf import fleet
from qdenv.simulate.mapf.audit import audit, trajectory_of
from qdenv.simulate.mapf.host.run import steps_under_way
from qdenv.simulate.mapf.metrics import Recording
from qdenv.study.options import fleet_tasks
from qdenv.types import TaskRule, Traffic

LOOK = 0.2  # seconds between two looks at how far the runs are
# (seed, what was counted, every step) -> what is kept of it
Reader: TypeAlias = Callable[[int, Traffic, Recording], Any]


class Simulated(NamedTuple):
    """The runs of one layout."""

    seeds: tuple[int, ...]  # one per run
    runs: list[Traffic]  # `Traffic` of numpy values
    readings: list[Any]  # what a reader made of each run; empty without one
    cpu_seconds: float  # of simulating all runs, without compiling and reading
    compile_seconds: float  # CPU seconds of compiling; 0 where the program was at hand


def run_seeds(
    layout: np.ndarray,
    tasks: TaskRule | None,
    config: fleet.FleetConfig,
    seeds: Sequence[int],
    agents: int | None = None,
    read: Reader | None = None,
    threads: int | None = None,
    progress: Progress = silent,
) -> Simulated:
    """Simulate a layout once per seed, on all cores.

    Args:
        layout: int8 [H, W].
        tasks: what the agents do.
        config: numbers of the simulation; every layout of one size shares its program.
        seeds: each decides starts, goals and ties of its run.
        agents: how many take part, at most ``config.agents``; None for all. Compiles nothing new.
        read: is handed every run with its recording, which is dropped then: all of them together
            may not fit the memory. Without it nothing is recorded.
        threads: runs at a time; None for as many as there are cores.
        progress: told how far the runs are.

    Raises:
        InputError: no fleet drives in this domain, or not on this layout.
    """
    count = config.agents if agents is None else agents
    tasks = fleet_tasks(layout, tasks, count)
    begin = time.process_time()
    program = _program(tasks, config, layout.shape, read is not None)
    if not program.ready:
        progress("compiling the simulator", -1, "")
    world = program.make_ready(layout)
    compiled = time.process_time()

    def one(seed: int) -> tuple[Traffic, Any, float]:
        traffic, recording = program.drive(world, seed, count)
        since = time.thread_time()
        reading = read(seed, traffic, recording) if read else None
        return traffic, reading, time.thread_time() - since

    # A compiled call leaves the interpreter lock, so threads use all cores.
    pool = ThreadPoolExecutor(threads or devices.threads())
    try:
        futures = [pool.submit(one, seed) for seed in seeds]
        _look_on(futures, config.timesteps, progress)
        results = [future.result() for future in futures]
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
    return Simulated(
        seeds=tuple(seeds),
        runs=[traffic for traffic, _, _ in results],
        readings=[reading for _, reading, _ in results if read],
        cpu_seconds=time.process_time() - compiled - sum(spent for _, _, spent in results),
        compile_seconds=compiled - begin,
    )


def _look_on(futures: Sequence[Future], timesteps: int, progress: Progress) -> None:
    """Tell of the progress until all runs have ended, or one has failed."""
    share, left = 0.0, set(futures)
    while left:
        done, left = wait(left, timeout=LOOK)
        for future in done:
            future.result()
        ended = len(futures) - len(left)
        # A run that has just ended is for a moment neither under way nor among the ended ones.
        share = max(share, (ended + steps_under_way() / timesteps) / len(futures))
        progress(
            "simulating", min(share, 1.0), f"run {min(ended + 1, len(futures))} of {len(futures)}"
        )


@dataclass
class _Program:
    """The simulation of layouts of one size."""

    prepare: Callable  # layout -> world
    run: Callable  # (world, seed, number of agents) -> traffic and recording
    on_host: bool  # runs are driven by compiled code of the host
    ready: bool = False  # that code has been loaded, or compiled

    def make_ready(self, layout: np.ndarray) -> Any:
        """Prepare a layout; the first one drives nobody around, which loads all that is needed."""
        world = self.prepare(layout)
        if self.on_host and not self.ready:
            self.drive(world, 0, 0)
        self.ready = True
        return world

    def drive(self, world: Any, seed: int, agents: int) -> tuple[Traffic, Any]:
        """Run once; the values are numpy's."""
        traffic, recording = jax.tree.map(np.asarray, self.run(world, seed, agents))
        return traffic, recording


@functools.lru_cache(maxsize=32)
def _program(
    tasks: TaskRule, config: fleet.FleetConfig, shape: tuple[int, int], record: bool
) -> _Program:
    """Compile the preparation and the simulation of layouts of one size."""
    layout = jax.ShapeDtypeStruct(shape, np.int8)
    prepare = jax.jit(lambda layout: fleet.prepare(layout, tasks, config))
    run = fleet.compile_runs(jax.eval_shape(prepare, layout), config, record)
    compiled = prepare.lower(layout).compile()
    if not config.make_planner().on_host:
        return _Program(compiled, run, False)
    return _Program(lambda layout: jax.tree.map(np.asarray, compiled(layout)), run, True)


def auditor(layout: np.ndarray, tasks: TaskRule, config: fleet.FleetConfig) -> Reader:
    """Make a reader that lists what a run did against the rules, with its seed."""

    def read(seed: int, run: Traffic, recording: Recording) -> list[str]:
        found = audit(layout, tasks, trajectory_of(recording), run, config.horizon)
        return [f"seed {seed}: {one}" for one in found]

    return read
