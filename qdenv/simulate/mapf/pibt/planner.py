"""PIBT: one step at a time, priorities inherited by the agent in the way.

Okumura et al. 2022, "Priority inheritance with backtracking for iterative multi-agent path
finding", Artificial Intelligence 310 (https://arxiv.org/abs/1901.11282), algorithm 1. Fast, and it
always lets the most urgent agent move, but it looks one step ahead only. It is a planner of its
own and the last resort of the negotiated planner. It must not be used to rank layouts: it reverses
the order that careful planning gives.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from qdenv.devices import runs_on_host
from qdenv.grid import NUM_MOVES, move_steps
from qdenv.native import shared
from qdenv.simulate.mapf import chance
from qdenv.simulate.mapf.host.state import HostRun
from qdenv.simulate.mapf.host.windows import DONE, Fallback, compile_windows
from qdenv.simulate.mapf.pibt import rules
from qdenv.simulate.mapf.pibt.settings import PibtConfig
from qdenv.simulate.mapf.pibt.xla import one_step
from qdenv.simulate.mapf.planner import AgentState, HostPlanner, Planner, World
from qdenv.simulate.mapf.tasks import serve


class _Agents(NamedTuple):
    """The agents within a rollout, each int32 [A]."""

    position: jax.Array  # where they stand
    stage: jax.Array  # 0 on the way to the current goal, 1 afterwards
    remaining_service: jax.Array  # timesteps left to serve
    age: jax.Array  # timesteps since the last finished task


@shared
def _plan_window(run: HostRun, fields: Any, plan: None, fallback: Fallback, seed: int) -> int:
    """Plan a window on the host: all agents follow the rollout."""
    fallback.is_used[:] = True
    return DONE


_run_windows = compile_windows(_plan_window)


def pibt(settings: PibtConfig) -> Planner:
    """Make the planner; both backends give the same paths to the bit."""
    on_host = HostPlanner(lambda run, size: None, _run_windows)
    return Planner(rollout, host=on_host if runs_on_host(settings.backend) else None)


def _preferences(
    world: World,
    distance: jax.Array,
    rows: jax.Array,
    position: jax.Array,
    fixed: jax.Array,
    bits: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """Sort the five ways of every agent: nearer to the goal, then empty, then by chance.

    Args:
        world: where.
        distance: int16 or int32 [rows, H' * W'], steps from every cell to goals.
        rows: int32 [A], those of the agents' goals.
        position: int32 [A].
        fixed: bool [A], agents that can only stay.
        bits: uint32 [A], break ties.

    Returns:
        candidates from best to worst (int32 [A, 5]), how many of them count (int32 [A]).
    """
    width = world.traversable.shape[1]
    size = world.traversable.size
    way = jnp.arange(NUM_MOVES)[None]
    cells = position[:, None] + jnp.asarray(move_steps(width))[None]
    standing = jnp.zeros((size,), bool).at[position].set(True)
    taken = standing[cells] & (way > 0)
    to_go = distance.reshape(-1)[rows[:, None] * size + cells].astype(jnp.int32)
    may_go = ~fixed[:, None] | (way == 0)
    open_cell = world.traversable.reshape(-1)[cells] & may_go
    key = rules.preference(to_go, taken, bits[:, None], way.astype(jnp.uint32)).astype(jnp.int32)
    best_first = jnp.argsort(jnp.where(open_cell, key, 2**30), axis=1)
    return jnp.take_along_axis(cells, best_first, axis=1), open_cell.sum(1, dtype=jnp.int32)


def rollout(world: World, state: AgentState, horizon: int, key: jax.Array) -> jax.Array:
    """Drive all agents for `horizon` steps; afterwards they wait.

    Agents that serve come first and stay; then the longer without a finished task, the earlier.

    Args:
        world: where.
        state: the agents.
        horizon: steps that will be driven.
        key: breaks ties.

    Returns:
        int32 [window + 1, A], without conflicts.
    """
    size, count = world.traversable.size, state.position.shape[0]
    ties = chance.draw(chance.seed_of(key), chance.RESORT)
    rank = chance.draw_many(chance.draw(ties, rules.RANKS), count)

    def step(agents: _Agents, t: jax.Array) -> tuple[_Agents, jax.Array]:
        fixed = (agents.remaining_service > 0) | ~state.active
        stage = agents.stage[None]
        slots = jnp.take_along_axis(state.goal, stage, axis=0)[0]
        service_time = jnp.take_along_axis(state.service_time, stage, axis=0)[0]
        order = jnp.argsort(rules.urgency(fixed, agents.age, rank)).astype(jnp.int32)
        tie_break = chance.draw_many(chance.draw(ties, rules.TIE_BREAKS + t), count)
        rows = jnp.take_along_axis(state.row, stage, axis=0)[0]
        candidates, allowed = _preferences(
            world, state.distance, rows, agents.position, fixed, tie_break
        )
        position = one_step(candidates, agents.position, allowed, order, size)
        on_goal = (position == world.goals.cells[slots]) & state.active
        remaining, finished = serve(agents.remaining_service, on_goal, service_time)
        # The goal after the next is not known here: an agent that has done both drives on freely.
        stage = jnp.minimum(agents.stage + finished, 1)
        return _Agents(position, stage, remaining, jnp.where(finished, 0, agents.age + 1)), position

    begin = _Agents(state.position, jnp.zeros_like(state.age), state.remaining_service, state.age)
    _, cells = jax.lax.scan(step, begin, jnp.arange(horizon, dtype=jnp.uint32))
    window = state.previous.shape[0] - 1
    still = jnp.broadcast_to(cells[-1], (window - horizon, count))
    return jnp.concatenate([state.position[None], cells, still])


def wait(world: World, state: AgentState, horizon: int, key: jax.Array) -> jax.Array:
    """Let everybody stand still, the last resort that congests as PBS does."""
    del world, horizon, key
    return jnp.broadcast_to(state.position, state.previous.shape)
