"""Base of the domains with a fleet of robots: settings, simulator and objective."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace
from typing import Any, Self

from qdenv.domains.base import DomainConfig, KnownSize, Simulator
from qdenv.lazy import jax, jnp
from qdenv.simulate.mapf.settings import FleetConfig
from qdenv.types import Array, TaskRule, Traffic

THROUGHPUT = "throughput [tasks per timestep]"


@dataclass(frozen=True)
class FleetDomainConfig(DomainConfig):
    """Settings of a domain with a fleet."""

    # agents, horizon and planner
    fleet: FleetConfig = field(default_factory=FleetConfig)  # type: ignore[misc]

    def scaled(self, ratio: float, size: KnownSize | None, given: Collection[str]) -> Self:
        """Scale the number of agents, or take the known one."""
        if "agents" in given:
            return self
        # The timesteps of a known size are those of reported numbers: a search uses shorter runs.
        agents = size.agents if size else max(1, round(self.fleet.agents * ratio))
        return replace(self, fleet=replace(self.fleet, agents=agents))


def fleet_simulator(tasks: TaskRule, config: FleetConfig) -> Simulator:
    """Make the simulator of lifelong multi-agent path finding, whose runs are `Traffic`."""

    # The simulation is imported when it first runs: it loads both compilers.
    def prepare(layout: Array) -> Any:
        from qdenv.simulate.mapf import fleet

        return fleet.prepare(layout, tasks, config)

    def run(world: Any, key: jax.Array) -> Traffic:
        from qdenv.simulate.mapf import fleet

        return fleet.simulate(world, key, config)

    return Simulator(prepare, run, tasks, on_host=lambda: config.make_planner().on_host)


def throughput(layout: Any, runs: Traffic) -> jax.Array:
    """Average the throughput over *all* runs, congested ones too: the objective f_res (float32).

    A run that congests ends early and counts with what it had finished, so a layout is paid for
    every run it spoils. Studies of single layouts report the mean of successful runs instead.
    """
    del layout
    return jnp.asarray(runs.throughput).mean()
