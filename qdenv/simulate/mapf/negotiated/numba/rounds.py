"""Rounds of negotiation compiled for one core of the host: `xla.rounds`, bit for bit.

On a CPU it takes a quarter of the time of XLA's program: nothing is computed for lanes without an
agent, rows out of reach and conflict levels that cannot pay, and small steps cost no kernel
launches.
"""

from typing import Any, NamedTuple

import jax
import numpy as np
from jax.experimental.buffer_callback import buffer_callback

from qdenv.native import compiled, inlined
from qdenv.simulate.mapf.negotiated import rules
from qdenv.simulate.mapf.negotiated.numba.observation import Agent, Grid, make_workspace
from qdenv.simulate.mapf.negotiated.numba.reservations import (
    Reservations,
    evict,
    no_reservations,
    pack,
    release,
    reserve,
)
from qdenv.simulate.mapf.negotiated.numba.search import find_path
from qdenv.simulate.mapf.negotiated.records import (
    PlanResult,
    Priorities,
    draw_priorities,
    penalty_costs,
    round_limit,
)
from qdenv.simulate.mapf.negotiated.settings import NegotiatedConfig
from qdenv.simulate.mapf.planner import AgentState, World
from qdenv.types import Array


class Layout(NamedTuple):
    """The arrays of a `World` that the negotiation needs.

    Attributes:
        traversable: bool [H', W'].
        goals: int32 [G], the goal cells.
        distance: int16 [G, H' * W'].
    """

    traversable: np.ndarray
    goals: np.ndarray
    distance: np.ndarray


class Terms(NamedTuple):
    """The numbers of a negotiation.

    Attributes:
        penalties: int32 [attempts], cost of driving over one reservation.
        lanes: agents that plan against the same reservations in one round.
        rounds: most rounds.
        conflict_levels: how finely conflicts are counted.
        remembered_steps: steps of the previous paths that are reserved before anybody plans.
    """

    penalties: np.ndarray
    lanes: int
    rounds: int
    conflict_levels: int
    remembered_steps: int


class Round(NamedTuple):
    """Who plans in one round, and what each found; the first `lanes` agents by urgency.

    Attributes:
        agent: int64 [lanes].
        path: int64 [lanes, w + 1].
        is_found: bool [lanes], there is a path at all.
    """

    agent: np.ndarray
    path: np.ndarray
    is_found: np.ndarray


def negotiate(
    config: NegotiatedConfig, world: World, state: AgentState, horizon: int, key: jax.Array
) -> PlanResult:
    """Do what `xla.rounds.negotiate` does, in a callback that works on jax's own buffers."""
    window, count = state.previous.shape[0] - 1, state.position.shape[0]
    lanes, penalties = min(config.lanes, count), penalty_costs(config)
    steps = window - horizon if config.remember else 0

    def on_host(_: Any, *buffers: Any) -> None:
        # Only numpy here: a jax call inside a callback can wait for the very device it blocks.
        result, limit, layout, state, priorities = jax.tree.map(np.asarray, buffers)
        terms = Terms(penalties, lanes, int(limit), config.conflict_levels, steps)
        run_rounds(Layout(*layout), state, priorities, terms, PlanResult(*result))

    layout = (world.traversable, world.goals.cells, world.distance)
    shapes = (
        jax.ShapeDtypeStruct((window + 1, count), np.int32),
        jax.ShapeDtypeStruct((count,), bool),
    )
    call = buffer_callback(on_host, shapes, vmap_method="sequential")
    return PlanResult(*call(round_limit(config, state), layout, state, draw_priorities(state, key)))


@compiled
def run_rounds(
    layout: Layout, state: AgentState, priorities: Priorities, terms: Terms, result: PlanResult
) -> None:
    """Run rounds of planning until everybody holds a reservation or the rounds are used up.

    Args:
        layout: the layout.
        state: the agents.
        priorities: what chance decides.
        terms: the numbers.
        result: receives the paths and whose are reserved.
    """
    count, window = state.position.size, state.previous.shape[0] - 1
    width = layout.traversable.shape[1]
    grid = Grid(pack(layout.traversable), layout.distance, layout.goals, width)
    reservations = no_reservations(grid.walls, width, state.previous)
    for agent in range(count):
        if state.active[agent]:
            reserve(reservations, agent, reservations.paths[agent], terms.remembered_steps)
    work = make_workspace(window, terms.conflict_levels)
    attempts = np.zeros(count, np.int64)
    who = Round(
        np.zeros(terms.lanes, np.int64),
        np.zeros((terms.lanes, window + 1), np.int64),
        np.zeros(terms.lanes, np.bool_),
    )
    for turn in range(terms.rounds):
        asking = most_urgent(priorities.order, attempts, reservations.reserved_steps, who)
        if asking == 0:
            break
        for lane in range(asking):
            release(reservations, who.agent[lane])
        for lane in range(asking):
            agent = who.agent[lane]
            asker = planning_agent(state, priorities, terms, agent, attempts[agent], turn)
            who.is_found[lane] = find_path(work, reservations, grid, asker, who.path[lane])
            attempts[agent] += 1
        settle(reservations, who, asking)
    result.paths[:] = reservations.paths.T
    result.is_reserved[:] = reservations.reserved_steps == window


@compiled
def most_urgent(order: Array, attempts: np.ndarray, reserved_steps: np.ndarray, who: Round) -> int:
    """Fill `who.agent` with those first in turn who hold no whole path; returns how many."""
    count, lanes, agents = 0, who.agent.size, order.size
    chosen = who.agent
    for agent in range(agents):
        if reserved_steps[agent] == who.path.shape[1] - 1:
            continue
        place = min(count, lanes)
        urgency = rules.urgency(order[agent], attempts[agent], agents)
        while place > 0:  # an insertion sort that forgets whoever falls off its end
            ahead = chosen[place - 1]
            if rules.urgency(order[ahead], attempts[ahead], agents) < urgency:
                break
            if place < lanes:
                chosen[place] = ahead
            place -= 1
        if place < lanes:
            chosen[place] = agent
            count = min(count + 1, lanes)
    return count


@inlined
def planning_agent(
    state: AgentState, priorities: Priorities, terms: Terms, agent: int, attempts: int, turn: int
) -> Agent:
    """Collect what the search needs to know of an agent that plans."""
    attempt = rules.penalty_index(attempts, terms.penalties.size)
    return Agent(
        int(state.position[agent]),
        (int(state.goal[0, agent]), int(state.goal[1, agent])),
        (int(state.service_time[0, agent]), int(state.service_time[1, agent])),
        int(state.remaining_service[agent]),
        int(terms.penalties[attempt]),
        rules.noise_of_round(int(priorities.noise[agent]), turn),
    )


@compiled
def settle(reservations: Reservations, who: Round, asking: int) -> None:
    """Reserve the paths chosen among those of the first `asking` agents; release what they hit."""
    chosen = choose(who.path[:asking], who.is_found[:asking])
    for lane in range(asking):
        if chosen[lane]:
            evict(reservations, who.path[lane])
    for lane in range(asking):
        if chosen[lane]:
            reserve(reservations, who.agent[lane], who.path[lane], who.path.shape[1] - 1)


@compiled
def choose(paths: np.ndarray, candidates: np.ndarray) -> np.ndarray:
    """Choose candidates (bool [K]) whose paths conflict with no earlier chosen one.

    The greedy choice in `rules.SWEEPS` sweeps over all at once.
    """
    count = candidates.size
    conflict = np.zeros((count, count), np.bool_)
    for i in range(count):
        for j in range(i):
            conflict[i, j] = candidates[i] and candidates[j] and in_conflict(paths[i], paths[j])
    chosen = candidates.copy()
    for _ in range(rules.SWEEPS):
        before = chosen.copy()
        for i in range(count):
            chosen[i] = candidates[i]
            for j in range(i):
                chosen[i] &= not (conflict[i, j] and before[j])
    return chosen


@inlined
def in_conflict(ours: np.ndarray, theirs: np.ndarray) -> bool:
    """Tell whether two paths have a vertex or swap conflict after their first cell."""
    for t in range(1, ours.size):
        if rules.steps_conflict(ours[t - 1], ours[t], theirs[t - 1], theirs[t]):
            return True
    return False
