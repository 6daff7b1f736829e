"""Rounds of negotiation compiled for one core of the host: what `xla.rounds` does, bit for bit."""

from typing import NamedTuple

import numpy as np

from qdenv.native import formula, kernel
from qdenv.simulate.mapf.host.crew import Run
from qdenv.simulate.mapf.host.fields import Fields
from qdenv.simulate.mapf.host.measure import lacks_room
from qdenv.simulate.mapf.host.site import Site
from qdenv.simulate.mapf.negotiated import rules
from qdenv.simulate.mapf.negotiated.numba.backtrack import trace
from qdenv.simulate.mapf.negotiated.numba.queue import Queue, most_urgent, wait
from qdenv.simulate.mapf.negotiated.numba.reservations import (
    Reservations,
    clear,
    holder,
    release,
    reserve,
    swapped_with,
)
from qdenv.simulate.mapf.negotiated.numba.search import find_path
from qdenv.simulate.mapf.negotiated.numba.states import Agent, Workspace, capped_penalty
from qdenv.simulate.mapf.planner import NOBODY


class Terms(NamedTuple):
    """The numbers of a negotiation."""

    penalties: np.ndarray  # int64 [attempts], cost of driving over one reservation
    rounds: int  # most rounds
    remembered_steps: int  # steps of the previous paths that are reserved before anybody plans


class Negotiation(NamedTuple):
    """Everything that a negotiation works on."""

    terms: Terms  # its numbers
    reservations: Reservations  # of all agents
    queue: Queue  # who is next
    work: Workspace  # of one search
    fields: Fields  # distances to the goals


@kernel
def negotiate(run: Run, plan: Negotiation) -> None:
    """Run rounds of planning until everybody holds a reservation or the rounds are used up.

    The paths and how much of them is reserved are left in `plan.reservations`.
    """
    crew, queue, reservations = run.crew, plan.queue, plan.reservations
    window = plan.work.mark.shape[0] - 1
    clear(reservations, run.site)
    for agent in range(crew.position.size):
        for t in range(window + 1):
            reservations.path[agent, t] = crew.paths[agent, t]
        reserve(reservations, agent, plan.terms.remembered_steps, run.site.width)
        queue.attempts[agent] = 0
        queue.heap[agent] = agent  # in order of urgency: a heap already
    queue.size[0] = crew.position.size
    for turn in range(plan.terms.rounds):
        asking = most_urgent(queue)
        if asking == 0 or lacks_room(plan.fields):
            break
        for lane in range(asking):
            release(reservations, queue.asking[lane], run.site.width)
        for lane in range(asking):
            _plan(run, plan, lane, turn)
        _choose(queue, reservations, asking)
        _settle(run.site, plan, asking)


@formula
def _plan(run: Run, plan: Negotiation, lane: int, turn: int) -> None:
    """Let one agent plan."""
    crew, site, queue = run.crew, run.site, plan.queue
    number = queue.asking[lane]
    first, second = crew.goal[0, number], crew.goal[1, number]
    attempt = rules.penalty_index(queue.attempts[number], plan.terms.penalties.size)
    kind, kinds = crew.kind[number], site.service_time.size
    agent = Agent(
        crew.position[number],
        (first, second),
        (site.goals[first], site.goals[second]),
        (site.service_time[kind], site.service_time[(kind + 1) % kinds]),
        crew.remaining_service[number],
        capped_penalty(plan.terms.penalties[attempt], plan.work.side // 2),
        rules.noise_of_round(queue.noise[number], turn),
    )
    code = find_path(plan.work, plan.reservations, plan.fields, site, agent)
    queue.is_found[lane] = code >= 0
    if code >= 0:
        trace(plan.work, plan.reservations, site, agent, code, number)
    queue.attempts[number] += 1


@formula
def _choose(queue: Queue, reservations: Reservations, asking: int) -> None:
    """Choose those found whose paths conflict with no earlier chosen one.

    The greedy choice in `rules.SWEEPS` sweeps over all at once.
    """
    chosen, conflict = queue.is_chosen, queue.conflict
    for lane in range(asking):
        chosen[0, lane] = queue.is_found[lane]
        for other in range(lane):
            both = queue.is_found[lane] and queue.is_found[other]
            conflict[lane, other] = both and _in_conflict(
                reservations.path, queue.asking[lane], queue.asking[other]
            )
    for _ in range(rules.SWEEPS):
        for lane in range(asking):
            chosen[1, lane] = queue.is_found[lane]
            for other in range(lane):
                chosen[1, lane] &= not (conflict[lane, other] and chosen[0, other])
        for lane in range(asking):
            chosen[0, lane] = chosen[1, lane]


@formula
def _in_conflict(path: np.ndarray, ours: int, theirs: int) -> bool:
    """Tell whether two agents' paths have a vertex or swap conflict after their first cell."""
    for t in range(1, path.shape[1]):
        if rules.steps_conflict(
            path[ours, t - 1], path[ours, t], path[theirs, t - 1], path[theirs, t]
        ):
            return True
    return False


@formula
def _settle(site: Site, plan: Negotiation, asking: int) -> None:
    """Reserve the chosen paths, and release those whom they drive over."""
    queue, reservations, window = plan.queue, plan.reservations, plan.work.mark.shape[0] - 1
    for lane in range(asking):
        if queue.is_chosen[0, lane]:
            _evict(site, plan, queue.asking[lane])
        else:
            wait(queue, queue.asking[lane])
    for lane in range(asking):
        if queue.is_chosen[0, lane]:
            reserve(reservations, queue.asking[lane], window, site.width)


@formula
def _evict(site: Site, plan: Negotiation, agent: int) -> None:
    """Release everybody whose reservations an agent's path drives over."""
    reservations, width = plan.reservations, site.width
    for t in range(plan.work.mark.shape[0] - 1):
        before, after = reservations.path[agent, t], reservations.path[agent, t + 1]
        met = holder(reservations, after, t)
        if met != NOBODY:
            _send_back(plan, met, width)
        met = swapped_with(reservations, before, after, t, width)
        if met != NOBODY:
            _send_back(plan, met, width)


@formula
def _send_back(plan: Negotiation, agent: int, width: int) -> None:
    """Release an agent, who queues again unless it never left the queue."""
    if plan.reservations.steps[agent] == plan.work.mark.shape[0] - 1:
        wait(plan.queue, agent)
    release(plan.reservations, agent, width)
