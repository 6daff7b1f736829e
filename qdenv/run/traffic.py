"""What `qdenv simulate` does: many simulations of one layout, audited on demand.

Seeds are simulated in threads: a compiled call releases the interpreter lock.
"""

import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qdenv.simulate.audit import audit, trajectory_of
from qdenv.simulate.fleet import FleetConfig, prepare, record, simulate
from qdenv.types import InputError, TaskRule, Traffic


class Outcome(NamedTuple):
    """All runs of one layout with one number of agents.

    Attributes:
        seeds: one per run.
        runs: `Traffic` with a leading axis S, on the host.
        cpu_seconds: of the process, mean per run.
        compile_seconds: of the process, spent on compiling.
        broken: messages of the audit, with their seeds; None where it was not asked for.
    """

    seeds: tuple[int, ...]
    runs: Traffic
    cpu_seconds: float
    compile_seconds: float
    broken: tuple[str, ...] | None


def parse_seeds(text: str) -> tuple[int, ...]:
    """Read seeds: a count ("3" is 0, 1, 2) or a list ("4,8,15").

    Raises:
        InputError: neither of the two.
    """
    try:
        numbers = tuple(int(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"seeds {text!r} are neither a count nor a list like 4,8,15") from None
    if "," not in text:
        if numbers[0] < 1:
            raise InputError("at least one seed is needed")
        return tuple(range(numbers[0]))
    if min(numbers) < 0 or len(set(numbers)) < len(numbers):
        raise InputError(f"seeds {text!r} must be different and not negative")
    return numbers


def with_capacity(layout: np.ndarray, rule: TaskRule, config: FleetConfig) -> FleetConfig:
    """Size the distance tables of one known layout: its goals, rounded up to words of 32."""
    goals = np.any([np.asarray(goal.weight(layout)) > 0 for goal in rule.cycle], axis=0).sum()
    return replace(config, goal_capacity=int(-(-max(goals, 1) // 32) * 32))


class Simulation:
    """One layout, prepared and compiled once, to be run for any seed and number of agents."""

    def __init__(
        self, layout: np.ndarray, rule: TaskRule, config: FleetConfig, check: bool = False
    ) -> None:
        """Prepare and compile; with `check`, runs are recorded and audited."""
        self.layout, self.rule, self.check = np.asarray(layout), rule, check
        self.config = config = with_capacity(self.layout, rule, config)
        before = time.process_time()
        self.problem = jax.jit(lambda tiles: prepare(tiles, rule, config))(jnp.asarray(layout))
        go = record if check else simulate
        compiled = jax.jit(lambda problem, key, agents: go(problem, key, rule, config, agents))
        key, agents = jax.random.key(0), jnp.int32(config.agents)
        self._run = compiled.lower(self.problem, key, agents).compile()
        self.compile_seconds = time.process_time() - before

    def run(self, seed: int, agents: int) -> tuple[Traffic, list[str]]:
        """Simulate once; returns the traffic and what the audit found."""
        result = self._run(self.problem, jax.random.key(seed), jnp.int32(agents))
        if not self.check:
            return jax.tree.map(np.asarray, result), []
        traffic, recording = jax.tree.map(np.asarray, result)
        found = audit(
            self.layout, self.rule, trajectory_of(recording), traffic, self.config.horizon
        )
        return traffic, [f"seed {seed}: {message}" for message in found]

    def outcome(
        self,
        seeds: Sequence[int],
        agents: int | None = None,
        progress: Callable[[int], None] = lambda done: None,
    ) -> Outcome:
        """Simulate all seeds, as many at a time as there are cores."""
        agents = self.config.agents if agents is None else agents
        before = time.process_time()
        with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
            results = []
            for result in pool.map(lambda seed: self.run(seed, agents), seeds):
                results.append(result)
                progress(len(results))
        return Outcome(
            seeds=tuple(seeds),
            runs=jax.tree.map(lambda *parts: np.stack(parts), *(run for run, _ in results)),
            cpu_seconds=(time.process_time() - before) / len(seeds),
            compile_seconds=self.compile_seconds,
            broken=tuple(m for _, found in results for m in found) if self.check else None,
        )


def describe(
    outcome: Outcome, layout: str, domain: str, planner: str, agents: int, timesteps: int
) -> dict[str, Any]:
    """State an outcome as the JSON of `qdenv simulate`.

    ``mean_throughput`` is over all runs; ``valid`` is None where no audit was asked for.
    """
    runs = outcome.runs
    rows = [
        {
            "seed": seed,
            "throughput": float(runs.throughput[index]),
            "congested": bool(runs.congested[index]),
            "end_timestep": int(runs.end_timestep[index]),
            "finished_tasks": int(runs.finished[index].sum()),
            "waiting": float(runs.waiting[index]),
            "path_length": float(runs.path_length[index]),
        }
        for index, seed in enumerate(outcome.seeds)
    ]
    return {
        "layout": layout,
        "domain": domain,
        "planner": planner,
        "agents": agents,
        "timesteps": timesteps,
        "runs": rows,
        "mean_throughput": float(runs.throughput.mean()),
        "success_rate": float(1 - runs.congested.mean()),
        "cpu_seconds_per_run": outcome.cpu_seconds,
        "compile_seconds": outcome.compile_seconds,
        "valid": None if outcome.broken is None else not outcome.broken,
        "broken": list(outcome.broken or ()),
    }
