"""What the tests of whole simulations share: task rules, random layouts, audited runs."""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from qdenv.registry import Entry
from qdenv.simulation.mapf import fleet
from qdenv.simulation.mapf.audit import audit
from qdenv.simulation.mapf.goals import check_playable, tile_goal
from qdenv.simulation.mapf.planner import Planner
from qdenv.simulation.mapf.settings import PLANNERS
from qdenv.types import InputError, TaskRule, Traffic

TILES = ".#ew"
PLAIN = TaskRule(TILES, ".ew", (tile_goal("e", TILES), tile_goal("w", TILES)))
# Kinds without a service, with a short one and with one longer than a window in one cycle.
SERVICES = TaskRule(
    TILES,
    ".ew",
    tuple(tile_goal("ewew"[kind], TILES, stay) for kind, stay in enumerate((0, 2, 11, 0))),
)
SHAPE = (12, 13)
AGENTS, TIMESTEPS = 64, 203  # T is no multiple of the replanning period on purpose
CONFIG = fleet.FleetConfig(agents=AGENTS, timesteps=TIMESTEPS, stop_when_congested=False)


def programs(rule: TaskRule, config: fleet.FleetConfig) -> tuple[Callable, Callable]:
    """Compile (layout -> world, (world, key, agents) -> traffic and recording)."""
    prepare = jax.jit(lambda layout: fleet.prepare(layout, rule, config))
    run = jax.jit(lambda world, key, agents: fleet.record(world, key, config, agents))
    return prepare, run


def random_layout(rng: np.random.Generator, walls: float) -> np.ndarray:
    """Draw a connected layout with both kinds of goal (int8 [12, 13])."""
    while True:
        layout = rng.choice(4, SHAPE, p=[0.8 - walls, walls, 0.12, 0.08]).astype(np.int8)
        try:
            check_playable(layout, PLAIN, 1)
        except InputError:
            continue
        return layout


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
