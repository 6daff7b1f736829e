"""What the tests of whole simulations share: task rules, random layouts, audited runs."""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from robustness.fleets import tasks_of

from qdenv.registry import Entry
from qdenv.simulation.mapf import fleet
from qdenv.simulation.mapf.audit import audit
from qdenv.simulation.mapf.host import run as host_run
from qdenv.simulation.mapf.host.distances import DistanceFields, empty_fields
from qdenv.simulation.mapf.planner import Planner
from qdenv.simulation.mapf.settings import PLANNERS
from qdenv.types import TaskRule, Traffic

PLAIN, SERVICES = tasks_of("plain"), tasks_of("services")
AGENTS, TIMESTEPS = 64, 203  # T is no multiple of the replanning period on purpose
CONFIG = fleet.FleetConfig(agents=AGENTS, timesteps=TIMESTEPS, stop_when_congested=False)


def programs(rule: TaskRule, config: fleet.FleetConfig) -> tuple[Callable, Callable]:
    """Compile (layout -> world, (world, key, agents) -> traffic and recording)."""
    prepare = jax.jit(lambda layout: fleet.prepare(layout, rule, config))
    run = jax.jit(lambda world, key, agents: fleet.record(world, key, config, agents))
    return prepare, run


def run_audited(
    programs: tuple[Callable, Callable],
    rule: TaskRule,
    config: fleet.FleetConfig,
    layout: np.ndarray,
    seed: int,
    agents: int,
) -> tuple[Traffic, int]:
    """Run and audit; returns the traffic and the number of agent-steps."""
    prepare, run = programs
    key, count = jax.random.key(seed), jnp.int32(agents)
    traffic, recording = jax.tree.map(np.asarray, run(prepare(jnp.asarray(layout)), key, count))
    assert audit(layout, rule, recording, traffic, config.horizon) == []
    return traffic, int(traffic.end_timestep) * agents


def give_little_room(monkeypatch) -> list[int]:
    """Let host code begin with too little room for distances; list how many rows each run wants."""
    rooms = []

    def little(shape: tuple[int, int], goals: int, rows: int, has_costs: bool) -> DistanceFields:
        rooms.append(rows)
        return empty_fields(shape, goals, 2, 3, has_costs)

    monkeypatch.setattr(host_run, "empty_fields", little)
    return rooms


@dataclass(frozen=True)
class StandConfig:
    """A user's own planner: nobody ever moves."""


def stand(settings: StandConfig) -> Planner:
    """Make the planner, with limits of its own."""
    del settings

    def plan(world, state, horizon, key):
        del world, horizon, key
        return jnp.broadcast_to(state.position, state.previous.shape)

    return Planner(plan, max_window=30, max_service=15, margin=2)


PLANNERS.register("stand", Entry(StandConfig, stand))
