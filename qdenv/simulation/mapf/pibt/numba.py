"""PIBT in compiled host code, agent by agent as the algorithm is printed, and its rules.

The rules are the conditions in function PIBT of algorithm 1 of the article that `planner` names, in
plain operators: numba compiles them here, `jax.numpy` traces them in `planner.rollout`, whose
result is the same bit for bit. Every argument of theirs is one integer, `NOBODY` where there is
none.
"""

from typing import NamedTuple, TypeVar

import jax
import numpy as np

from qdenv.grid import NUM_MOVES
from qdenv.native import formula, kernel, shared
from qdenv.simulation.mapf import chance
from qdenv.simulation.mapf.host.distances import DistanceFields, distance
from qdenv.simulation.mapf.host.state import AGENT, AGENT_BITS, HostRun, service_time, sort
from qdenv.simulation.mapf.pibt.swap import pull
from qdenv.simulation.mapf.planner import NOBODY, serve

Number = TypeVar("Number", int, jax.Array)

RANKS, TIE_BREAKS = 0, 1  # what is drawn for a rollout; the ties of step t by TIE_BREAKS + t
RANK_BITS, TIE_BITS = 12, 5
_PATIENCE = 100  # timesteps without a finished task after which agents that swap change their turn
_OLDEST = (1 << 17) - 1  # agents that have waited longer are equally urgent


@shared
def urgency(fixed: Number, age: Number, bits: Number) -> Number:
    """Rank agents (smallest first): those that cannot move, the longest without a task, by chance.

    The age counts timesteps since the agent last finished a task; of 32 random bits the first few
    break ties.
    """
    age = age - (age > _OLDEST) * (age - _OLDEST)
    return (1 - fixed) * (((_OLDEST - age) << RANK_BITS) + (bits >> (32 - RANK_BITS)) + 1)


@shared
def preference(to_go: Number, taken: Number, bits: Number, way: Number) -> Number:
    """Rank a way (smallest first): nearer to the goal, then empty before taken, then by chance."""
    tie_break = (bits >> (TIE_BITS * way)) & ((1 << TIE_BITS) - 1)
    return (((to_go << 1) + taken) << TIE_BITS) + tie_break


@shared
def is_admissible(
    cell: Number, position: Number, claimant: Number, other_next: Number, pusher_position: Number
) -> Number:
    """Return True if an agent at `position` may take a candidate cell.

    Not if another one takes it in this step already (a vertex conflict), nor if the agent that
    stands there comes here (a swap), nor if the agent's pusher stands there: it wants to come here.
    """
    return (claimant == NOBODY) & (other_next != position) & (cell != pusher_position)


@shared
def is_pushed(other: Number, agent: Number, other_next: Number) -> Number:
    """Return True if `other`, which stands where `agent` goes, inherits its priority.

    It does if it is another agent that has not decided yet where it goes (`other_next`).
    """
    return (other != NOBODY) & (other != agent) & (other_next == NOBODY)


class Rollout(NamedTuple):
    """The agents within a rollout of h steps; A agents, N cells."""

    path: np.ndarray  # int64 [A, h + 1], where they go
    stage: np.ndarray  # int64 [A], 0 on the way to the current goal, 1 afterwards
    remaining_service: np.ndarray  # int64 [A], timesteps left to serve
    age: np.ndarray  # int64 [A], timesteps since the last finished task
    order: np.ndarray  # int64 [A], the agents packed with their urgency, the most urgent first
    num_allowed: np.ndarray  # int64 [A], how many of its candidates count
    num_tried: np.ndarray  # int64 [A], how many were tried
    pusher: np.ndarray  # int64 [A], the agent that pushed it, or `NOBODY`
    partner: np.ndarray  # int64 [A], the agent it pulls along, or `NOBODY`
    candidates: np.ndarray  # int64 [A, 5], the cells each may go to, from best to worst
    key: np.ndarray  # int64 [5], what orders the candidates of one agent
    # int32 [N], the agent on each cell, or `NOBODY`; between two steps `NOBODY` everywhere
    occupant: np.ndarray
    claimant: np.ndarray  # int32 [N], the agent that takes each cell, or `NOBODY`, as above


def make_rollout(agents: int, horizon: int, cells: int) -> Rollout:
    """Make the arrays of rollouts."""
    path, candidates = (np.zeros((agents, size), np.int64) for size in (horizon + 1, NUM_MOVES))
    occupant, claimant = np.full((2, cells), NOBODY, np.int32)
    stage, remaining, age, order, allowed, tried, pusher, partner = np.zeros((8, agents), np.int64)
    state = path, stage, remaining, age, order, allowed, tried, pusher, partner
    return Rollout(*state, candidates, np.zeros(NUM_MOVES, np.int64), occupant, claimant)


@kernel
def roll_out(
    run: HostRun,
    fields: DistanceFields,
    rollout: Rollout,
    seed: int,
    stands_still: bool,
    swaps: bool | None,
) -> None:
    """Find where PIBT drives all agents, as `planner.rollout` does; or let all stand still.

    `swaps` is None where agents change no places: numba leaves that out then.
    """
    ties = chance.mix(seed, chance.RESORT)
    rank = chance.mix(ties, RANKS)
    for agent in range(run.position.size):
        rollout.path[agent, 0], rollout.stage[agent] = run.position[agent], 0
        rollout.remaining_service[agent] = run.remaining_service[agent]
        rollout.age[agent] = run.age[agent]
    for t in range(rollout.path.shape[1] - 1):
        if stands_still:
            for agent in range(run.position.size):
                rollout.path[agent, t + 1] = run.position[agent]
            continue
        tie_break = chance.mix(ties, TIE_BREAKS + t)
        for agent in range(run.position.size):
            age = rollout.age[agent]
            if swaps is not None and age > _PATIENCE:
                # Agents that hold one another up for good get another order every few timesteps.
                age = (chance.mix(chance.mix(ties, agent), age >> 4) >> 8) % _PATIENCE
            turn = urgency(rollout.remaining_service[agent] > 0, age, chance.mix(rank, agent))
            rollout.order[agent] = (turn << AGENT_BITS) | agent
            rollout.occupant[rollout.path[agent, t]] = agent
        for agent in range(run.position.size):
            _prefer(run, fields, rollout, agent, t, chance.mix(tie_break, agent))
        sort(rollout.order)
        push_along(run, fields, rollout, t, swaps)
        for agent in range(run.position.size):
            stage = rollout.stage[agent]
            goal, time = run.grid.goals[run.goal[stage, agent]], service_time(run, agent, stage)
            on_goal = rollout.path[agent, t + 1] == goal
            left, finished = serve(rollout.remaining_service[agent], on_goal, time)
            rollout.remaining_service[agent] = left
            rollout.age[agent] += 1
            if finished:
                # The goal after the next is not known here: after both, an agent drives freely.
                rollout.stage[agent], rollout.age[agent] = 1, 0


@formula
def _prefer(
    run: HostRun, fields: DistanceFields, rollout: Rollout, agent: int, t: int, bits: int
) -> None:
    """Sort the ways of one agent: nearer to the goal, then empty before taken, then by chance."""
    cell, slot = rollout.path[agent, t], run.goal[rollout.stage[agent], agent]
    ways = 1 if rollout.remaining_service[agent] > 0 else NUM_MOVES
    candidates, keys, count = rollout.candidates, rollout.key, 0
    has_costs = run.grid.costs.size > 0
    for way in range(ways):
        other = cell + run.grid.steps[way]
        if not run.grid.free[other]:
            continue
        taken = way > 0 and rollout.occupant[other] != NOBODY
        to_go = distance(fields, run.grid, slot, other)
        if has_costs:
            if way > 0 and run.grid.costs[way, cell] == 0:
                continue
            to_go += run.grid.costs[way, cell]
        key = preference(to_go, taken, bits, way)
        # An insertion keeps equal keys in the order of the moves, as a stable sort does in XLA.
        place = count
        while place > 0 and keys[place - 1] > key:
            keys[place], candidates[agent, place] = keys[place - 1], candidates[agent, place - 1]
            place -= 1
        keys[place], candidates[agent, place] = key, other
        count += 1
    rollout.num_allowed[agent] = count


@kernel
def push_along(
    run: HostRun, fields: DistanceFields, rollout: Rollout, t: int, swaps: bool | None
) -> None:
    """Move all agents by one step, to t + 1: the most urgent first, after those in its way.

    The recursion of the paper is a chain that each agent leaves towards its pusher.
    """
    path, occupant, claimant = rollout.path, rollout.occupant, rollout.claimant
    path[:, t + 1], rollout.num_tried[:] = NOBODY, 0
    rollout.pusher[:], rollout.partner[:] = NOBODY, NOBODY
    for index in range(path.shape[0]):
        first = rollout.order[index] & AGENT
        agent = first if path[first, t + 1] == NOBODY else NOBODY
        while agent != NOBODY:
            here, behind = path[agent, t], rollout.pusher[agent]
            if swaps is not None and rollout.num_allowed[agent] > 1:
                pull(run, fields, rollout, agent, t)
            if rollout.num_tried[agent] >= rollout.num_allowed[agent]:
                # Nowhere to go: stay, and let the pusher try on.
                path[agent, t + 1] = here
                claimant[here] = agent
                agent = behind
                continue
            cell = rollout.candidates[agent, rollout.num_tried[agent]]
            rollout.num_tried[agent] += 1
            other = occupant[cell]
            other_next = path[other, t + 1] if other != NOBODY else NOBODY
            pusher_position = path[behind, t] if behind != NOBODY else NOBODY
            if not is_admissible(cell, here, claimant[cell], other_next, pusher_position):
                continue
            path[agent, t + 1] = cell
            claimant[cell] = agent
            if is_pushed(other, agent, other_next):
                rollout.pusher[other] = agent
                agent = other
            else:
                agent = NOBODY
    for agent in range(path.shape[0]):
        occupant[path[agent, t]] = NOBODY
        claimant[path[agent, t + 1]] = NOBODY
