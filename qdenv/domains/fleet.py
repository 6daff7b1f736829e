"""What the domains with fleets of robots share: their numbers, and how tasks are simulated."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace
from typing import Any, Self

from qdenv.domains.base import DomainConfig, KnownSize, Simulator
from qdenv.lazy import jax
from qdenv.score import mean_throughput
from qdenv.simulate.mapf.settings import FleetConfig
from qdenv.types import Array, TaskRule, Traffic

THROUGHPUT = "throughput [tasks per timestep]"


@dataclass(frozen=True)
class FleetDomainConfig(DomainConfig):
    """What the settings of a domain with a fleet hold."""

    fleet: FleetConfig = field(default_factory=FleetConfig)  # agents, horizon and planner

    def for_area(self, ratio: float, given: Collection[str]) -> Self:
        """Let the number of agents follow the area."""
        return self._with_agents(max(1, round(self.fleet.agents * ratio)), given)

    def for_known(self, size: KnownSize, given: Collection[str]) -> Self:
        """Take the number of agents; a search does without the long runs of reported numbers."""
        return self._with_agents(size.agents, given)

    def _with_agents(self, agents: int, given: Collection[str]) -> Self:
        if "agents" in given:
            return self
        return replace(self, fleet=replace(self.fleet, agents=agents))


def fleet_simulator(tasks: TaskRule, config: FleetConfig) -> Simulator:
    """Make the simulator of lifelong multi-agent path finding, whose runs are `Traffic`.

    Args:
        tasks: what the agents do.
        config: how many they are, for how long, and who plans their paths.
    """

    def prepare(layout: Array) -> Any:
        return _fleet().prepare(layout, tasks, config)

    def run(world: Any, key: jax.Array) -> Traffic:
        return _fleet().simulate(world, key, config)

    def on_host() -> bool:
        return config.make_planner().on_host

    return Simulator(prepare, run, tasks, on_host=on_host)


def _fleet() -> Any:
    """Import the simulation, and both compilers with it, when somebody simulates."""
    from qdenv.simulate.mapf import fleet

    return fleet


def throughput(layout: Any, runs: Traffic) -> jax.Array:
    """Score a layout by the mean throughput over its runs: the objective f_res (float32)."""
    del layout
    return mean_throughput(runs)
