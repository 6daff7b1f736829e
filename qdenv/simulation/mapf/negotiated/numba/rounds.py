"""Rounds of negotiation on one core of the host: what `xla.rounds` does, bit for bit."""

from typing import NamedTuple

import numpy as np

from qdenv.native import Numbers, formula, kernel, numbers, shared
from qdenv.simulation.mapf import chance
from qdenv.simulation.mapf.host.distances import DistanceFields
from qdenv.simulation.mapf.host.run import DONE, FIELDS_FULL, Fallback, compile_windows
from qdenv.simulation.mapf.host.state import (
    AGENT,
    AGENT_BITS,
    HostRun,
    paths_meet,
    service_time,
    sift,
    sort,
)
from qdenv.simulation.mapf.negotiated import rules
from qdenv.simulation.mapf.negotiated.numba.search import (
    AGAINST,
    WALL,
    Agent,
    ReservationWords,
    find_path,
    reserve,
)
from qdenv.simulation.mapf.negotiated.numba.states import SearchArrays, make_arrays
from qdenv.simulation.mapf.negotiated.settings import MAX_SERVICE, NegotiatedConfig
from qdenv.simulation.mapf.planner import move_of


class HostNegotiation(NamedTuple):
    """Everything that a negotiation works on, but for the distances."""

    rounds: int  # most rounds
    remembered_steps: int  # steps of the previous paths that are reserved before anybody plans
    numbers: Numbers  # waiting, how many wait
    # int64 [A], the agents that wait, packed with their urgency, negative: `sift` wants a maximum
    heap: np.ndarray
    order: np.ndarray  # int64 [A], the rank of each agent, drawn at random
    tie_break: np.ndarray  # int64 [A], bits that settle ties
    attempts: np.ndarray  # int64 [A], how often each agent has planned in this window
    planning: np.ndarray  # int64 [lanes], the agents that plan in this round
    is_found: np.ndarray  # bool [lanes], whether each found a path
    is_chosen: np.ndarray  # bool [2, lanes], whose path is taken, before and after a sweep
    conflict: np.ndarray  # bool [lanes, lanes], whose paths conflict
    reservations: ReservationWords  # of all agents
    work: SearchArrays  # of one search


def make_plan(config: NegotiatedConfig, run: HostRun, size: int) -> HostNegotiation:
    """Make what the planner works on; no buffer can be too small, so the size is 1."""
    agents, horizon = run.position.size, run.settings.horizon
    window = config.planned_ahead(run.settings.window, horizon)
    lanes, has_costs = min(config.lanes, agents), run.grid.costs.size > 0
    heap, order, tie_break, attempts = np.empty((4, agents), np.int64)
    return HostNegotiation(
        int(config.max_rounds(agents)),
        window - horizon if config.remember else 0,
        numbers("waiting"),
        heap,
        order,
        tie_break,
        attempts,
        np.empty(lanes, np.int64),
        np.empty(lanes, np.bool_),
        np.empty((2, lanes), np.bool_),
        np.empty((lanes, lanes), np.bool_),
        ReservationWords(
            np.empty(run.grid.free.size, np.int64),
            np.empty((run.grid.free.size, window + 1), np.int32),
            np.zeros((agents, window + 1), np.int64),
            np.zeros(agents, np.int64),
        ),
        make_arrays(window, config.conflict_levels, config.penalty_costs(has_costs), has_costs),
    )


@shared
def _plan_window(
    run: HostRun, fields: DistanceFields, plan: HostNegotiation, fallback: Fallback, seed: int
) -> int:
    """Plan a window; agents without a whole reserved path fall back."""
    _negotiate(run, fields, plan, seed)
    if fields.numbers.is_full:
        return FIELDS_FULL
    reservations, last = plan.reservations, plan.reservations.path.shape[1] - 1
    for agent in range(run.position.size):
        fallback.is_used[agent] = reservations.steps[agent] < last
        for t in range(fallback.path.shape[1]):
            fallback.path[agent, t] = reservations.path[agent, min(t, last)]
    return DONE


run_windows = compile_windows(_plan_window)


@kernel
def _negotiate(run: HostRun, fields: DistanceFields, plan: HostNegotiation, seed: int) -> None:
    """Run rounds of planning until every agent holds a reservation or the rounds are used up.

    The paths and how much of them is reserved are left in `plan.reservations`.
    """
    reservations, heap, width = plan.reservations, plan.heap, run.grid.width
    window = reservations.path.shape[1] - 1
    for cell in range(run.grid.free.size):
        reservations.word[cell] = 0 if run.grid.free[cell] else WALL
    order, ties = chance.mix(seed, chance.ORDER), chance.mix(seed, chance.TIES)
    for agent in range(heap.size):
        for t in range(window + 1):
            reservations.path[agent, t] = run.paths[agent, t]
        reservations.steps[agent] = 0
        reserve(reservations, agent, plan.remembered_steps, width)
        rank = rules.random_rank(chance.mix(order, agent), run.remaining_service[agent] > 0)
        heap[agent] = (rank << AGENT_BITS) | agent
        plan.tie_break[agent] = chance.mix(ties, agent) >> (32 - rules.TIE_BITS)
        plan.attempts[agent] = 0
    sort(heap)
    for rank in range(heap.size):
        agent = heap[rank] & AGENT
        plan.order[agent] = rank
        heap[rank] = -((rank << AGENT_BITS) | agent)  # in order of urgency: a heap already
    plan.numbers.waiting = heap.size
    for turn in range(plan.rounds):
        count = min(plan.numbers.waiting, plan.planning.size)
        if count == 0 or fields.numbers.is_full:
            break
        for lane in range(count):
            plan.planning[lane] = -heap[0] & AGENT
            plan.numbers.waiting -= 1
            heap[0] = heap[plan.numbers.waiting]
            sift(heap, 0, plan.numbers.waiting)
            reserve(reservations, plan.planning[lane], 0, width)
        for lane in range(count):
            _plan(run, fields, plan, lane, turn)
        _choose(plan, count)
        # An agent that is not chosen queues again, and so do those whose reservations are driven
        # over.
        for lane in range(count):
            if plan.is_chosen[0, lane]:
                _evict(plan, plan.planning[lane], width)
            else:
                _wait(plan, plan.planning[lane])
        for lane in range(count):
            if plan.is_chosen[0, lane]:
                reserve(reservations, plan.planning[lane], window, width)


@formula
def _plan(
    run: HostRun, fields: DistanceFields, plan: HostNegotiation, lane: int, turn: int
) -> None:
    """Let one agent plan."""
    grid, number = run.grid, plan.planning[lane]
    first, second = run.goal[0, number], run.goal[1, number]
    attempt = min(plan.attempts[number], plan.work.penalties.size - 1)
    # Whatever is longer does not end within a window, however long it is.
    serving = min(service_time(run, number, 0), MAX_SERVICE)
    serving_next = min(service_time(run, number, 1), MAX_SERVICE)
    agent = Agent(
        number,
        run.position[number],
        (first, second),
        (grid.goals[first], grid.goals[second]),
        (serving, serving_next),
        min(run.remaining_service[number], serving),
        plan.work.penalties[attempt],
        plan.tie_break[number] ^ (turn * rules.ROUND_TIE_BREAK),
        int(run.kind[number] == len(grid.odds)),
    )
    plan.is_found[lane] = find_path(plan.work, plan.reservations, fields, grid, agent)
    plan.attempts[number] += 1


@formula
def _choose(plan: HostNegotiation, count: int) -> None:
    """Choose, of the paths that were found, those that conflict with no earlier chosen one.

    The greedy choice in `rules.SWEEPS` sweeps over all at once.
    """
    found, chosen, conflict = plan.is_found, plan.is_chosen, plan.conflict
    path, planning = plan.reservations.path, plan.planning
    for lane in range(count):
        chosen[0, lane] = found[lane]
        for other in range(lane):
            both = found[lane] and found[other]
            conflict[lane, other] = both and paths_meet(
                path, planning[lane], path, planning[other], path.shape[1] - 1
            )
    for _ in range(rules.SWEEPS):
        for lane in range(count):
            chosen[1, lane] = found[lane]
            for other in range(lane):
                chosen[1, lane] &= not (conflict[lane, other] and chosen[0, other])
        for lane in range(count):
            chosen[0, lane] = chosen[1, lane]


@formula
def _evict(plan: HostNegotiation, agent: int, width: int) -> None:
    """Release all agents whose reservations an agent's path drives over."""
    word, owner, path = plan.reservations.word, plan.reservations.owner, plan.reservations.path
    window = path.shape[1] - 1
    for t in range(window):
        before, after = path[agent, t], path[agent, t + 1]
        for swap in range(2):
            # Who is in the cell at t + 1; who comes from there, against this step.
            plane = AGAINST[move_of(after - before, width)] if swap else 0
            if (plane or not swap) and word[after] >> (plane + t) & 1:
                met = owner[after, t + 1 - swap]
                if plan.reservations.steps[met] == window:  # else it never left the queue
                    _wait(plan, met)
                reserve(plan.reservations, met, 0, width)


@formula
def _wait(plan: HostNegotiation, agent: int) -> None:
    """Put an agent into the queue: the fewer attempts the earlier, then by lot."""
    heap, hole = plan.heap, plan.numbers.waiting
    urgency = plan.attempts[agent] * heap.size + plan.order[agent]
    pack = -((urgency << AGENT_BITS) | agent)
    plan.numbers.waiting += 1
    while hole > 0 and heap[(hole - 1) // 2] < pack:
        heap[hole] = heap[(hole - 1) // 2]
        hole = (hole - 1) // 2
    heap[hole] = pack
