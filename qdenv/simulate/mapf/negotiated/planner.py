"""The windowed planner: prioritised planning in which agents bargain over who gives way.

A set of agents holds reservations that never conflict. Round after round, a few agents without a
reservation plan against it. A path may drive over reservations, at a penalty for each: if that is
cheaper than stepping aside, the path is taken and the owners lose their reservations and plan
again. The penalty grows with every attempt of an agent within the window. So at first everybody
asks for the shortest way, and then whoever can step aside most cheaply does: the parallel
counterpart of priority-based search choosing the cheaper child (RHCR, Li et al. 2021).

Agents left without a reservation after the last round fall back to a path from `last_resort`, as
do those in conflict with one that fell back. The last resort is a joint plan without conflicts,
so the result never has any.
"""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp

from qdenv.simulate.mapf.negotiated.numba import rounds as bargain_on_host
from qdenv.simulate.mapf.negotiated.xla import rounds as bargain
from qdenv.simulate.mapf.negotiated.xla.rounds import PlanResult
from qdenv.simulate.mapf.pibt import planner as pibt
from qdenv.simulate.mapf.planner import AgentState, World, conflicts
from qdenv.types import Array, InputError


def by_backend(
    settings: "WindowedPlanner", world: World, state: AgentState, horizon: int, key: Array
) -> PlanResult:
    """Bargain in compiled host code where jax computes on a CPU, else in XLA: the same result."""
    where = bargain_on_host if jax.default_backend() == "cpu" else bargain
    return where.bargain(settings, world, state, horizon, key)


@dataclass(frozen=True)
class WindowedPlanner:
    """Plan windows by bargaining; every setting of the planner.

    Attributes:
        lookahead: timesteps planned without conflict, at most the simulation's window.
        lanes: agents that plan side by side in one round.
        rounds: most rounds per agent-lane ratio, in units of ``agents / lanes``.
        layers: how finely driven-over reservations are counted (1 + the count told apart).
        penalties: timesteps an agent would rather lose than drive over one reservation, by attempt.
        last_resort: joint plan for agents that found no reservation.
        remember: let planners avoid, at no cost, where the others went in the last plan.
        bargain: how agents get their reservations: `host` on a CPU, `bargain` elsewhere.
    """

    lookahead: int = 10
    lanes: int = 8
    rounds: float = 12.0
    layers: int = 4
    penalties: tuple[float, ...] = (
        *(0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5),
        *(4.5, 5.5, 6.5, 8.5, 11.0, 16.0),
    )
    last_resort: Callable[[World, AgentState, int, Array], Array] = pibt.rollout
    remember: bool = True
    bargain: Callable[["WindowedPlanner", World, AgentState, int, Array], PlanResult] = by_backend

    def __post_init__(self) -> None:
        """Refuse layers whose counts would overflow a path's price."""
        if not 1 <= self.layers <= 4:
            raise InputError(f"a windowed planner tells 1 to 4 layers apart, not {self.layers}")

    def __call__(self, world: World, state: AgentState, horizon: int, key: Array) -> Array:
        """Plan a window for all agents (int32 [window + 1, A]); consumes the key."""
        bargain_key, resort_key = jax.random.split(key)
        window = state.previous.shape[0] - 1
        ahead = max(horizon, min(self.lookahead, window))
        near = state._replace(previous=state.previous[: ahead + 1])
        result = self.bargain(self, world, near, horizon, bargain_key)
        paths = settle(self, world, near, horizon, result, resort_key)
        rest = jnp.broadcast_to(paths[-1], (window - ahead, paths.shape[1]))
        return jnp.concatenate([paths, rest])


def settle(
    planner: WindowedPlanner,
    world: World,
    state: AgentState,
    horizon: int,
    result: PlanResult,
    key: Array,
) -> jax.Array:
    """Give agents without a reservation the last resort, and everybody in their way too."""

    def fall_back(_: None) -> jax.Array:
        resort = planner.last_resort(world, state, horizon, key)
        clash = conflicts(result.paths[: horizon + 1], resort[: horizon + 1])
        clash = clash & ~jnp.eye(clash.shape[0], dtype=bool)
        clash = clash & state.active[:, None] & state.active[None, :]

        def spread(carry: tuple[Array, Array]) -> tuple[Array, Array]:
            falls, _ = carry
            more = falls | (clash & falls[None, :]).any(1)
            return more, (more != falls).any()

        falls, _ = jax.lax.while_loop(lambda c: c[1], spread, (~result.holds, jnp.bool_(True)))
        paths = jnp.where(falls, resort, result.paths)
        # Beyond the horizon the two kinds of path may conflict: forget that part.
        beyond = jnp.arange(paths.shape[0])[:, None] > horizon
        return jnp.where(beyond, paths[horizon], paths)

    return jax.lax.cond(result.holds.all(), lambda _: result.paths, fall_back, None)


# Low for the inside of a search: half of high's time for 3 to 4 % less throughput.
HIGH = WindowedPlanner()
LOW = WindowedPlanner(
    lookahead=7, lanes=16, rounds=4.0, layers=3, penalties=(0.5, 1.5, 2.5, 4.5, 8.0, 16.0)
)
EFFORTS = {"low": LOW, "high": HIGH}
