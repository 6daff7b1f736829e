"""What domains with a fleet of robots share: simulator and objective."""

from __future__ import annotations

from typing import Any

from qdenv.domains.base import Simulator
from qdenv.lazy import LazyModule, jax, jnp
from qdenv.simulation.mapf.settings import PLANNERS, FleetConfig
from qdenv.types import TaskRule, Traffic

# Imported when it first runs: it loads both compilers.
fleet: Any = LazyModule("qdenv.simulation.mapf.fleet")
THROUGHPUT = "throughput [tasks per timestep]"


def fleet_simulator(tasks: TaskRule, config: FleetConfig) -> Simulator:
    """Make the simulator of lifelong multi-agent path finding, whose runs are `Traffic`.

    Li et al. 2021, https://arxiv.org/abs/2005.07371: agents get a new goal at each goal, and plan
    again every few timesteps. `tasks` says where they drive and what they do, `config` how many
    they are, for how long, and by which planner.
    """
    return Simulator(
        prepare=lambda layout, costs=None: fleet.prepare(layout, tasks, config, costs),
        run=lambda world, key: fleet.simulate(world, key, config),
        tasks=tasks,
        count_moves=lambda world, key: fleet.count_moves(world, key, config),
        on_host=lambda: PLANNERS.make(config.planner).on_host,
    )


def throughput(layout: Any, runs: Traffic) -> jax.Array:
    """Average the throughput over *all* runs, congested ones too: the objective f_res (float32).

    A run that congests ends early and counts with what it had finished, so a layout pays for
    every run it spoils. Studies of single layouts report the mean of successful runs instead.
    """
    return jnp.asarray(runs.throughput).mean()
