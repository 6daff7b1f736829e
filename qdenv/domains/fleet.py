"""What domains with a fleet of robots share: simulator and objective."""

from __future__ import annotations

from typing import Any

from qdenv.domains.base import Simulator
from qdenv.lazy import jax, jnp
from qdenv.simulation.mapf.settings import PLANNERS, FleetConfig
from qdenv.types import Array, TaskRule, Traffic

THROUGHPUT = "throughput [tasks per timestep]"


def fleet_simulator(tasks: TaskRule, config: FleetConfig) -> Simulator:
    """Make the simulator of lifelong multi-agent path finding, whose runs are `Traffic`.

    Li et al. 2021, https://arxiv.org/abs/2005.07371: agents get a new goal at each goal, and plan
    again every few timesteps.

    Args:
        tasks: where agents drive, and what they do.
        config: numbers of agents and timesteps, and the planner.
    """

    # The simulation is imported when it first runs: it loads both compilers.
    def prepare(layout: Array, costs: Array | None = None) -> Any:
        from qdenv.simulation.mapf import fleet

        return fleet.prepare(layout, tasks, config, costs)

    def run(world: Any, key: jax.Array) -> Traffic:
        from qdenv.simulation.mapf import fleet

        return fleet.simulate(world, key, config)

    def count_moves(world: Any, key: jax.Array) -> jax.Array:
        from qdenv.simulation.mapf import fleet

        return fleet.count_moves(world, key, config)

    on_host = lambda: PLANNERS.make(config.planner).on_host  # noqa: E731
    return Simulator(prepare, run, tasks, count_moves, on_host=on_host)


def throughput(layout: Any, runs: Traffic) -> jax.Array:
    """Average the throughput over *all* runs, congested ones too: the objective f_res (float32).

    A run that congests ends early and counts with what it had finished, so a layout is paid for
    every run it spoils. Studies of single layouts report the mean of successful runs instead.
    """
    return jnp.asarray(runs.throughput).mean()
