"""What the domains with fleets of robots share: their numbers, and how tasks are simulated."""

from dataclasses import dataclass, field
from typing import Any

import jax

from qdenv.domains.base import DomainConfig, Simulator
from qdenv.score.traffic import mean_throughput
from qdenv.simulate.mapf.fleet import FleetConfig, prepare, simulate
from qdenv.types import TaskRule, Traffic

THROUGHPUT = "throughput [tasks per timestep]"


@dataclass(frozen=True)
class FleetDomainConfig(DomainConfig):
    """What the settings of a domain with a fleet hold.

    Attributes:
        fleet: agents, horizon and planner.
    """

    fleet: FleetConfig = field(default_factory=FleetConfig)


def fleet_simulator(tasks: TaskRule, config: FleetConfig) -> Simulator:
    """Make the simulator of lifelong multi-agent path finding, whose runs are `Traffic`.

    Args:
        tasks: what the agents do.
        config: how many they are, for how long, and who plans their paths.
    """
    return Simulator(
        prepare=lambda layout: prepare(layout, tasks, config),
        run=lambda world, key: simulate(world, key, config),
        tasks=tasks,
    )


def throughput(layout: Any, runs: Traffic) -> jax.Array:
    """Score a layout by the mean throughput over its runs: the objective f_res (float32)."""
    del layout
    return mean_throughput(runs)
