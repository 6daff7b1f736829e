"""The negotiated planner: prioritised planning in which agents bargain over who gives way.

A set of agents holds reservations that never conflict. Round after round, a few agents without a
reservation plan against it. A path may drive over reservations, at a penalty for each: if that is
cheaper than stepping aside, the path is taken and the owners lose their reservations and plan
again. The penalty grows with every attempt of an agent within the window. So at first all agents
take the shortest way, and then those step aside that can do so most cheaply.

This is negotiated congestion, as routers of circuits do it (PathFinder, McMurchie & Ebeling 1995,
https://doi.org/10.1145/201310.201328), with reservations as soft obstacles (SIPPS in MAPF-LNS2, Li
et al. 2022, https://doi.org/10.1609/aaai.v36i9.21266), for the windows of lifelong planning (RHCR,
Li et al. 2021, https://arxiv.org/abs/2005.07371). There priority-based search takes the cheaper of
two children; here many agents look for the cheaper way at the same time.

Agents left without a reservation after the last round fall back to a path of the last resort, as
do those in conflict with one that fell back. The last resort is a joint plan without conflicts
(PIBT, Okumura et al. 2022, https://arxiv.org/abs/1901.11282), so the result never has any.
"""

from functools import partial

import jax
import jax.numpy as jnp

from qdenv.grid import fixed_point
from qdenv.simulation.mapf import chance
from qdenv.simulation.mapf.negotiated.numba.rounds import make_plan, run_windows
from qdenv.simulation.mapf.negotiated.settings import MARGIN, MAX_WINDOW, NegotiatedConfig
from qdenv.simulation.mapf.negotiated.xla.rounds import negotiate, path_conflicts
from qdenv.simulation.mapf.pibt.planner import rollout
from qdenv.simulation.mapf.planner import AgentState, Planner, World


def negotiated(config: NegotiatedConfig) -> Planner:
    """Make the planner; both backends give the same paths to the bit."""
    waits = config.last_resort == "wait"  # as PBS does, which congests

    def plan(world: World, state: AgentState, horizon: int, key: jax.Array) -> jax.Array:
        window, agents = state.previous.shape[0] - 1, state.position.shape[0]
        ahead = config.planned_ahead(window, horizon)
        near = state._replace(previous=state.previous[: ahead + 1])

        def fall_back() -> jax.Array:
            still = jnp.broadcast_to(near.position, near.previous.shape)
            resort = still if waits else rollout(world, near, horizon, key)
            conflicts = path_conflicts(result.paths[: horizon + 1], resort[: horizon + 1])
            conflicts = conflicts & state.active[:, None]  # padding never falls back
            falls = fixed_point(
                lambda falls: falls | (conflicts & falls[None, :]).any(1), ~result.is_reserved
            )
            paths = jnp.where(falls, resort, result.paths)
            # Beyond the horizon the two kinds of path may conflict: forget that part.
            beyond = jnp.arange(ahead + 1)[:, None] > horizon
            return jnp.where(beyond, paths[horizon], paths)

        # Sets of cells broadcast over agents on purpose, also where a caller forbids it at large.
        with jax.numpy_rank_promotion("allow"):
            result = negotiate(config, world, near, horizon, chance.seed_of(key))
            paths = jax.lax.cond(result.is_reserved.all(), lambda: result.paths, fall_back)
        return jnp.concatenate([paths, jnp.broadcast_to(paths[-1], (window - ahead, agents))])

    return Planner(
        plan,
        max_window=MAX_WINDOW,
        margin=MARGIN,
        run_windows=run_windows if config.backend != "xla" else None,
        make_plan=partial(make_plan, config),
        fallback_waits=waits,
        reads_costs=True,
    )
