"""What the domains with fleets of robots share: how a task rule becomes a simulator."""

from collections.abc import Callable

import jax

from qdenv.domains.base import EvaluationConfig, Simulator
from qdenv.simulate.mapf import fleet
from qdenv.simulate.mapf.negotiated.settings import EFFORTS
from qdenv.types import TaskRule, look_up

# On an accelerator many simulations run side by side; on a CPU one after the other, because
# then a simulation pays only for its own conflicts.
ACCELERATOR_LANES = 128


def fleet_simulator(rule: TaskRule) -> Callable[[EvaluationConfig], Simulator]:
    """Make a domain's simulator of lifelong multi-agent path finding.

    Args:
        rule: what the agents do.

    Returns:
        function from the numbers of an evaluation to a `Simulator` whose runs are `Traffic`.
    """

    def simulator(config: EvaluationConfig) -> Simulator:
        settings = fleet.FleetConfig(
            agents=config.agents,
            timesteps=config.timesteps,
            planner=look_up(EFFORTS, config.effort, "effort"),
        )
        return Simulator(
            prepare=lambda layout: fleet.prepare(layout, rule, settings),
            run=lambda world, key: fleet.simulate(world, key, rule, settings),
            lanes=1 if jax.default_backend() == "cpu" else ACCELERATOR_LANES,
        )

    return simulator
