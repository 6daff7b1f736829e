"""Studies of one layout's traffic: simulate it over seeds, audit what happened, report it."""

import functools
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
import numpy as np

from qdenv import devices
from qdenv.domains.base import find_domain
from qdenv.simulate.mapf import fleet
from qdenv.simulate.mapf.audit import audit, trajectory_of
from qdenv.simulate.mapf.goals import check_playable
from qdenv.study.options import describe_planner, find_planner, parse_seeds
from qdenv.study.table import summarise
from qdenv.types import InputError, TaskRule, Traffic


class Simulated(NamedTuple):
    """The runs of one layout.

    Attributes:
        seeds: one per run.
        runs: `Traffic` of numpy values.
        recordings: trajectories where they were asked for, else empty.
        cpu_seconds: of all runs together, compilation left out.
        compile_seconds: CPU seconds of compiling; 0 where the program was at hand.
    """

    seeds: tuple[int, ...]
    runs: list[Traffic]
    recordings: list[fleet.Recording]
    cpu_seconds: float
    compile_seconds: float


def run_seeds(
    layout: np.ndarray,
    tasks: TaskRule | None,
    config: fleet.FleetConfig,
    seeds: Sequence[int],
    agents: int | None = None,
    record: bool = False,
    threads: int | None = None,
) -> Simulated:
    """Simulate a layout once per seed, on all cores.

    Args:
        layout: int8 [H, W].
        tasks: what the agents do.
        config: numbers of the simulation; every layout of one size shares its program.
        seeds: each decides starts, goals and ties of its run.
        agents: how many take part, at most ``config.agents``; None for all. Compiles nothing new.
        record: keep the trajectories.
        threads: runs at a time; None for as many as there are cores.

    Raises:
        InputError: no fleet drives in this domain, or not on this layout.
    """
    if tasks is None:
        raise InputError("no fleet drives in this domain: there is no traffic to simulate")
    count = config.agents if agents is None else agents
    check_playable(layout, tasks, count)
    begin = time.process_time()
    prepare, simulate = _programs(tasks, config, layout.shape, record)
    compiled = time.process_time()
    world = prepare(layout)

    def one(seed: int) -> tuple:
        return jax.tree.map(np.asarray, simulate(world, jax.random.key(seed), np.int32(count)))

    # A compiled call leaves the interpreter lock, so threads use all cores.
    with ThreadPoolExecutor(threads or devices.threads()) as pool:
        results = list(pool.map(one, seeds))
    spent = time.process_time() - compiled
    return Simulated(
        tuple(seeds),
        [traffic for traffic, _ in results],
        [recording for _, recording in results if record],
        spent,
        compiled - begin,
    )


@functools.lru_cache(maxsize=32)
def _programs(
    tasks: TaskRule, config: fleet.FleetConfig, shape: tuple[int, int], record: bool
) -> tuple[Callable, Callable]:
    """Compile the preparation and the simulation of layouts of one size."""

    def run(world: Any, key: Any, count: Any) -> tuple:
        if record:
            return fleet.record(world, key, config, count)
        return fleet.simulate(world, key, config, count), None

    layout = jax.ShapeDtypeStruct(shape, np.int8)
    prepare = jax.jit(lambda layout: fleet.prepare(layout, tasks, config))
    world = jax.eval_shape(prepare, layout)
    arguments = (world, jax.random.key(0), jax.ShapeDtypeStruct((), np.int32))
    return prepare.lower(layout).compile(), jax.jit(run).lower(*arguments).compile()


def simulate_layout(
    layout: np.ndarray,
    domain: str = "warehouse-even",
    agents: int = 200,
    timesteps: int = 1000,
    seeds: int | str | Sequence[int | str] = 10,
    effort: str = "high",
    check: bool = False,
    planner: str = "",
) -> dict[str, Any]:
    """Simulate a layout over seeds and report it in JSON-ready values.

    Args:
        layout: int8 [H, W].
        domain: name of the domain.
        agents: number of agents.
        timesteps: horizon T.
        seeds: how many, or a list; see `parse_seeds`.
        effort: "low" or "high".
        check: audit every trajectory; without it "valid" is None.
        planner: name of another registered planner.

    Returns:
        domain, planner, agents, timesteps, runs (seed, throughput, congested, end_timestep,
        finished_tasks), mean_throughput (over the runs that never congested; None where every
        run did), mean_of_all (over all runs), success_rate, cpu_seconds_per_run,
        compile_seconds, valid, broken.

    Raises:
        InputError: a name is unknown, or the fleet cannot work on this layout.
    """
    settings = find_planner(effort, planner)
    tasks = find_domain(domain).simulator.tasks
    config = fleet.FleetConfig(agents=agents, timesteps=timesteps, planner=settings)
    done = run_seeds(layout, tasks, config, parse_seeds(seeds), record=check)
    wrong = broken_rules(layout, tasks, config, done) if check and tasks else []
    row = summarise(domain, layout, agents, done.runs, done.cpu_seconds)
    return {
        "domain": domain,
        "planner": describe_planner(settings),
        "agents": agents,
        "timesteps": timesteps,
        "runs": [describe(seed, run) for seed, run in zip(done.seeds, done.runs, strict=True)],
        "mean_throughput": row.throughput if row.success_rate else None,
        "mean_of_all": row.mean_of_all,
        "success_rate": row.success_rate,
        "cpu_seconds_per_run": round(row.cpu_seconds_per_run, 4),
        "compile_seconds": round(done.compile_seconds, 3),
        "valid": not wrong if check else None,
        "broken": wrong,
    }


def broken_rules(
    layout: np.ndarray, tasks: TaskRule, config: fleet.FleetConfig, done: Simulated
) -> list[str]:
    """Audit all recorded runs; returns what they did against the rules, with the seed."""
    return [
        f"seed {seed}: {found}"
        for seed, run, tape in zip(done.seeds, done.runs, done.recordings, strict=True)
        for found in audit(layout, tasks, trajectory_of(tape), run, config.horizon)
    ]


def describe(seed: int, run: Traffic) -> dict[str, Any]:
    """Reduce one run to its JSON-ready numbers."""
    return {
        "seed": int(seed),
        "throughput": float(run.throughput),
        "congested": bool(run.congested),
        "end_timestep": int(run.end_timestep),
        "finished_tasks": int(run.finished.sum()),
    }
