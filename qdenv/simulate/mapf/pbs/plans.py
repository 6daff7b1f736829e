"""The paths of all agents together, where they conflict, and changes that can be undone."""

from typing import NamedTuple

import numpy as np

from qdenv.native import formula, kernel
from qdenv.simulate.mapf.pbs.errands import Errands
from qdenv.simulate.mapf.pbs.path import DELAY, Search

OLD, NEW = 0, 1  # of a change
LAST, BOUND, LATE = range(3)  # entries of `Plan.fact` and `Changes.fact`
TIME_BIT, FIRST_BIT, AGENT_BITS = 48, 24, 24  # of a conflict, which sorts by its time


class Plan(NamedTuple):
    """The joint plan in hand; A agents, w timesteps."""

    # int32 [w + 1, A], where they are; after a path's end a number of the agent's own below zero,
    # which is no cell
    cell: np.ndarray
    # int32 [3, A], the timestep at which a path ends; the first timestep at which nothing binds the
    # agent to its start any more; how much longer than the shortest way it is
    fact: np.ndarray
    total: np.ndarray  # int64 [1], the sum of the latter
    # int32 [A], the timesteps of conflicts of one agent with each other one, a bit each
    hit: np.ndarray


class Changes(NamedTuple):
    """Changes of paths, in the order in which they were made; R of them at most."""

    agent: np.ndarray  # int32 [R]
    cell: np.ndarray  # int32 [R, 2, w + 1], the column of `Plan.cell` before and after
    fact: np.ndarray  # int32 [R, 2, 3], that of `Plan.fact`
    made: np.ndarray  # int64 [1], how many there are


def make_plan(agents: int, window: int) -> Plan:
    """Make room for a joint plan."""
    cell, fact = np.zeros((window + 1, agents), np.int32), np.zeros((3, agents), np.int32)
    return Plan(cell, fact, np.zeros(1, np.int64), np.zeros(agents, np.int32))


def make_changes(room: int, window: int) -> Changes:
    """Make room for changes."""
    cell, fact = np.empty((room, 2, window + 1), np.int32), np.empty((room, 2, 3), np.int32)
    return Changes(np.empty(room, np.int32), cell, fact, np.zeros(1, np.int64))


@kernel
def be_nowhere(plan: Plan, errands: Errands) -> None:
    """Begin with nobody but those whom a service keeps at their start: all know of them."""
    window = plan.cell.shape[0] - 1
    plan.total[0] = 0
    for agent in range(plan.cell.shape[1]):
        last = min(errands.begin[agent], window)
        plan.fact[LAST, agent], plan.fact[BOUND, agent] = last, last + 1
        plan.fact[LATE, agent] = 0
        for t in range(window + 1):
            plan.cell[t, agent] = errands.start[agent] if t <= last else -1 - agent


@kernel
def adopt_path(
    plan: Plan, search: Search, errands: Errands, agent: int, terms: tuple[int, bool]
) -> None:
    """Give an agent the path that was found.

    Args:
        plan: receives it.
        search: holds it.
        errands: what agents have to do.
        agent: whose it is.
        terms: its last timestep; whether waiting at the start has precedence there.
    """
    last, clings = terms
    start = errands.start[agent]
    bound = min(errands.begin[agent], last) + 1
    while clings and bound <= last and search.cells[bound] == start:
        bound += 1
    plan.total[0] += search.number[DELAY] - plan.fact[LATE, agent]
    plan.fact[LAST, agent], plan.fact[BOUND, agent] = last, bound
    plan.fact[LATE, agent] = search.number[DELAY]
    for t in range(plan.cell.shape[0]):
        plan.cell[t, agent] = search.cells[t] if t <= last else -1 - agent


@kernel
def note(plan: Plan, changes: Changes, agent: int, when: int) -> None:
    """Write the path of an agent down, before (`OLD`) or after (`NEW`) a change."""
    change = changes.made[0]
    changes.agent[change] = agent
    for t in range(plan.cell.shape[0]):
        changes.cell[change, when, t] = plan.cell[t, agent]
    for index in range(3):
        changes.fact[change, when, index] = plan.fact[index, agent]
    changes.made[0] += when


@kernel
def redo(plan: Plan, changes: Changes, change: int, when: int) -> None:
    """Make one change (`NEW`), or undo it (`OLD`)."""
    agent = changes.agent[change]
    plan.total[0] += changes.fact[change, when, LATE] - plan.fact[LATE, agent]
    for t in range(plan.cell.shape[0]):
        plan.cell[t, agent] = changes.cell[change, when, t]
    for index in range(3):
        plan.fact[index, agent] = changes.fact[change, when, index]


@kernel
def find_conflicts(plan: Plan, agent: int) -> None:
    """Find with whom an agent conflicts, and when: bit t of ``plan.hit`` (own entry: 0).

    Two agents conflict where they are on one cell, or swap cells on the way to timestep t.
    """
    cell, hit = plan.cell, plan.hit
    for other in range(hit.size):
        hit[other] = 0
    for t in range(1, plan.fact[LAST, agent] + 1):
        here, before = cell[t, agent], cell[t - 1, agent]
        bit = np.int32(1 << t)  # of the width of `hit`, so that eight go into one instruction
        for other in range(hit.size):
            meets = cell[t, other] == here
            swaps = (cell[t, other] == before) & (cell[t - 1, other] == here)
            hit[other] |= bit if meets | swaps else np.int32(0)
    hit[agent] = 0


@formula
def first_of(bits: int) -> int:
    """Find the lowest bit that is set."""
    t = 0
    while not (bits >> t) & 1:
        t += 1
    return t


@formula
def conflict(t: int, one: int, other: int) -> int:
    """Pack a conflict: packs sort by time, then by the smaller number of an agent."""
    return (t << TIME_BIT) | (min(one, other) << FIRST_BIT) | max(one, other)


@formula
def parts_of(pack: int) -> tuple[int, int, int]:
    """Read time and agents of a conflict."""
    agents = (1 << AGENT_BITS) - 1
    return pack >> TIME_BIT, (pack >> FIRST_BIT) & agents, pack & agents
