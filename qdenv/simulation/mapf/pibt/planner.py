"""PIBT: one step at a time, priorities inherited by the agent in the way.

Okumura et al. 2022, "Priority inheritance with backtracking for iterative multi-agent path
finding", Artificial Intelligence 310 (https://arxiv.org/abs/1901.11282), algorithm 1. Fast, and it
always lets the most urgent agent move, but it looks one step ahead only. It is a planner of its
own and the last resort of the negotiated planner. It must not be used to rank layouts: it gives
another order than careful planning.

Here it is one loop without callbacks, each turn of which tries one candidate; `numba` is the same
algorithm in the form a person reads.
"""

from typing import Any, TypeAlias

import jax
import jax.numpy as jnp

from qdenv.grid import NUM_MOVES, move_steps
from qdenv.native import shared
from qdenv.simulation.mapf import chance
from qdenv.simulation.mapf.host.run import DONE, Fallback, compile_windows
from qdenv.simulation.mapf.host.state import HostRun
from qdenv.simulation.mapf.pibt.numba import (
    RANKS,
    TIE_BREAKS,
    is_admissible,
    is_pushed,
    preference,
    urgency,
)
from qdenv.simulation.mapf.planner import NOBODY, AgentState, Planner, World, serve
from qdenv.simulation.mapf.settings import PibtConfig

# The agents within a rollout, each int32 [A]: cells; 0 on the way to the current goal, 1 later;
# timesteps left to serve; timesteps since the last finished task.
_Agents: TypeAlias = tuple[jax.Array, jax.Array, jax.Array, jax.Array]
# The search within one timestep: where each agent goes, `NOBODY` while undecided (int32 [A + 1]);
# the agent that takes each cell, or `NOBODY` (int32 [cells + 1]); candidates that each agent has
# used up; the agent that pushed it, or `NOBODY` (int32 [A + 1] each); the agent whose turn it is,
# or `NOBODY` to take the next by priority; agents taken from the priority list so far.
# The last entry of every array belongs to `NOBODY`.
_Chain: TypeAlias = tuple[jax.Array, jax.Array, jax.Array, jax.Array, jax.Array, jax.Array]


@shared
def _plan_window(run: HostRun, fields: Any, plan: None, fallback: Fallback, seed: int) -> int:
    """Plan a window on the host: all agents follow the rollout."""
    fallback.is_used[:] = True
    return DONE


_run_windows = compile_windows(_plan_window)


def pibt(settings: PibtConfig) -> Planner:
    """Make the planner; both backends give the same paths to the bit."""
    on_host = settings.swap or settings.backend != "xla"
    return Planner(
        None if settings.swap else rollout,
        run_windows=_run_windows if on_host else None,
        fallback_swaps=settings.swap,
        reads_costs=True,
    )


def rollout(world: World, state: AgentState, horizon: int, key: jax.Array) -> jax.Array:
    """Drive all agents for `horizon` steps; afterwards they wait.

    Agents that serve come first and stay; then the longer without a finished task, the earlier.
    The five ways of an agent are sorted: nearer to the goal, then empty, then by chance.
    Returns int32 [window + 1, A], without conflicts; the key breaks ties.
    """
    traversable, goals = world.traversable.reshape(-1), world.goals.cells
    size, count = traversable.size, state.position.shape[0]
    moves = jnp.asarray(move_steps(world.traversable.shape[1]))[None]
    way = jnp.arange(NUM_MOVES)[None]
    ties = chance.draw(chance.seed_of(key), chance.RESORT)
    rank = chance.draw(chance.draw(ties, RANKS), jnp.arange(count))

    def step(agents: _Agents, t: jax.Array) -> tuple[_Agents, jax.Array]:
        position, stage, remaining_service, age = agents
        fixed = (remaining_service > 0) | ~state.active
        slots, service_time, rows = (
            jnp.take_along_axis(both, stage[None], axis=0)[0]
            for both in (state.goal, state.service_time, state.row)
        )
        cells = position[:, None] + moves
        taken = jnp.zeros((size,), bool).at[position].set(True)[cells] & (way > 0)
        to_go = state.distance.reshape(-1)[rows[:, None] * size + cells].astype(jnp.int32)
        tie_break = chance.draw(chance.draw(ties, TIE_BREAKS + t), jnp.arange(count))
        may_go = traversable[cells] & (~fixed[:, None] | (way == 0))
        if world.costs is not None:
            cost = world.costs.T[position]
            to_go, may_go = to_go + cost, may_go & ((cost > 0) | (way == 0))
        keys = preference(to_go, taken, tie_break[:, None], way.astype(jnp.uint32))
        # Above all preferences: what an agent may not do comes last.
        best_first = jnp.argsort(jnp.where(may_go, keys.astype(jnp.int32), 2**30), axis=1)
        position = one_step(
            jnp.take_along_axis(cells, best_first, axis=1),
            position,
            may_go.sum(1, dtype=jnp.int32),
            jnp.argsort(urgency(fixed, age, rank)).astype(jnp.int32),
            size,
        )
        on_goal = (position == goals[slots]) & state.active
        remaining_service, finished = serve(remaining_service, on_goal, service_time)
        # The goal after the next is not known here: an agent that has done both drives on freely.
        stage = jnp.minimum(stage + finished, 1)
        return (position, stage, remaining_service, jnp.where(finished, 0, age + 1)), position

    begin = (state.position, jnp.zeros_like(state.age), state.remaining_service, state.age)
    _, cells = jax.lax.scan(step, begin, jnp.arange(horizon, dtype=jnp.uint32))
    still = jnp.broadcast_to(cells[-1], (state.previous.shape[0] - 1 - horizon, count))
    return jnp.concatenate([state.position[None], cells, still])


def one_step(
    candidates: jax.Array, position: jax.Array, allowed: jax.Array, order: jax.Array, cells: int
) -> jax.Array:
    """Move all agents by one step on a grid of `cells` cells, without conflict (int32 [A]).

    An agent's `candidates` (int32 [A, 5]) are cells from best to worst, of which the first
    `allowed` (int32 [A]) count; its own is among them. `position` (int32 [A]) holds distinct cells,
    `order` (int32 [A]) the agents by falling priority.
    """
    count = position.shape[0]
    nobody = jnp.full((count + 1,), NOBODY, jnp.int32)
    on_no_cell = jnp.full((cells + 1,), NOBODY, jnp.int32)
    occupant = on_no_cell.at[position].set(jnp.arange(count, dtype=jnp.int32))
    position = nobody.at[:count].set(position)

    def visit(chain: _Chain) -> _Chain:
        # Index `NOBODY` (-1) reads the last entry of an array, which is `NOBODY` again; so no rule
        # needs a mask.
        next_cell, claimant, tried, pusher, current, rank = chain
        taking = current == NOBODY
        agent = jnp.where(taking, order[jnp.minimum(rank, count - 1)], current)
        skip = taking & (next_cell[agent] != NOBODY)  # it was pushed before its own turn
        behind = pusher[agent]
        spent = tried[agent] >= allowed[agent]
        cell = candidates[agent, jnp.minimum(tried[agent], NUM_MOVES - 1)]
        other, here = occupant[cell], position[agent]
        other_next = next_cell[other]
        free = is_admissible(cell, here, claimant[cell], other_next, position[behind])
        good = ~skip & ~spent & free
        fail = ~skip & spent  # nowhere to go: stay, and let the pusher try on
        push = good & is_pushed(other, agent, other_next)
        follower = jnp.where(good | skip, NOBODY, agent)
        follower = jnp.where(push, other, jnp.where(fail, behind, follower))
        # What is not settled is written to the entries of `NOBODY`.
        settled, cell = good | fail, jnp.where(good, cell, here)
        writer = jnp.where(settled, agent, NOBODY)
        target = jnp.where(settled, cell, NOBODY)
        return (
            next_cell.at[writer].set(target),
            claimant.at[target].set(writer),
            tried.at[jnp.where(skip, NOBODY, agent)].add(1),
            pusher.at[jnp.where(push, other, NOBODY)].set(agent),
            follower.astype(jnp.int32),
            rank + taking,
        )

    current, rank = jnp.int32(NOBODY), jnp.int32(0)
    chain = nobody, on_no_cell, jnp.zeros_like(nobody), nobody, current, rank
    chain = jax.lax.while_loop(
        lambda chain: (chain[5] < count) | (chain[4] != NOBODY), visit, chain
    )
    return chain[0][:count]
