"""Rounds of negotiation on one core of the host: what `xla.rounds` does, bit for bit."""

from typing import NamedTuple

import numpy as np

from qdenv.native import Scalar, formula, kernel, shared
from qdenv.simulate.mapf import chance
from qdenv.simulate.mapf.host.distances import DistanceFields
from qdenv.simulate.mapf.host.state import Agents, HostRun, agent_of, ranked, sift, sort
from qdenv.simulate.mapf.host.windows import DONE, FIELDS_FULL, Fallback, compile_windows
from qdenv.simulate.mapf.negotiated import path_rules, rules
from qdenv.simulate.mapf.negotiated.numba.backtrack import trace
from qdenv.simulate.mapf.negotiated.numba.reservations import (
    ReservationWords,
    clear,
    holder,
    make_reservations,
    release,
    reserve,
    swapped_with,
)
from qdenv.simulate.mapf.negotiated.numba.search import (
    Agent,
    SearchArrays,
    capped_penalty,
    find_path,
    make_arrays,
)
from qdenv.simulate.mapf.negotiated.settings import NegotiatedConfig
from qdenv.simulate.mapf.planner import NOBODY, HostPlanner


class Queue(NamedTuple):
    """The agents without a whole reserved path, and those who plan in this round."""

    heap: np.ndarray  # int64 [A], the urgencies of those who wait, negative: `sift` wants a maximum
    size: Scalar  # int64 [], how many wait
    order: np.ndarray  # int64 [A], the rank of each agent, drawn at random
    turn: np.ndarray  # int64 [A], the agent of each rank
    tie_break: np.ndarray  # int64 [A], bits that settle ties
    attempts: np.ndarray  # int64 [A], how often each agent has planned in this window
    planning: np.ndarray  # int64 [lanes], the agents that plan in this round
    is_found: np.ndarray  # bool [lanes], whether each found a path
    is_chosen: np.ndarray  # bool [2, lanes], whose path is taken, before and after a sweep
    conflict: np.ndarray  # bool [lanes, lanes], whose paths conflict


class HostNegotiation(NamedTuple):
    """Everything that a negotiation works on, but for the distances."""

    penalties: np.ndarray  # int64 [attempts], cost of driving over one reservation
    rounds: int  # most rounds
    remembered_steps: int  # steps of the previous paths that are reserved before anybody plans
    reservations: ReservationWords  # of all agents
    queue: Queue  # who is next
    work: SearchArrays  # of one search


def host_planner(config: NegotiatedConfig) -> HostPlanner:
    """Make the planner for the host."""

    def make_plan(run: HostRun, size: int) -> HostNegotiation:
        del size  # no buffer can be too small
        agents, horizon = run.agents.position.size, run.settings.horizon
        window = config.planned_ahead(run.settings.window, horizon)
        penalties, lanes = (
            config.penalty_costs(path_rules.COST_UNIT).astype(np.int64),
            config.num_lanes(agents),
        )
        order, turn, tie_break, attempts, heap = np.empty((5, agents), np.int64)
        queue = Queue(
            heap,
            np.zeros((), np.int64),
            order,
            turn,
            tie_break,
            attempts,
            np.empty(lanes, np.int64),
            np.empty(lanes, np.bool_),
            np.empty((2, lanes), np.bool_),
            np.empty((lanes, lanes), np.bool_),
        )
        return HostNegotiation(
            penalties,
            int(config.max_rounds(agents)),
            window - horizon if config.remember else 0,
            make_reservations(run.grid, agents, window),
            queue,
            make_arrays(window, config.conflict_levels, int(penalties.max())),
        )

    return HostPlanner(make_plan, _run_windows, config.last_resort == "wait")


@shared
def _plan_window(
    run: HostRun, fields: DistanceFields, plan: HostNegotiation, fallback: Fallback, seed: int
) -> int:
    """Plan a window; agents without a whole reserved path fall back."""
    _draw_order(plan.queue, run.agents, seed)
    _negotiate(run, fields, plan)
    if fields.is_full[()]:
        return FIELDS_FULL
    reservations, last = plan.reservations, plan.reservations.path.shape[1] - 1
    for agent in range(run.agents.position.size):
        fallback.is_used[agent] = reservations.steps[agent] < last
        for t in range(fallback.path.shape[1]):
            fallback.path[agent, t] = reservations.path[agent, min(t, last)]
    return DONE


_run_windows = compile_windows(_plan_window)


@kernel
def _draw_order(queue: Queue, agents: Agents, seed: int) -> None:
    """Draw the agents' order and the bits that settle ties, as `xla.rounds.draw_priorities`."""
    order, ties = chance.mix(seed, chance.ORDER), chance.mix(seed, chance.TIES)
    for agent in range(queue.turn.size):
        serving = agents.remaining_service[agent] > 0
        queue.heap[agent] = ranked(rules.random_rank(chance.mix(order, agent), serving), agent)
        queue.tie_break[agent] = rules.tie_break_of(chance.mix(ties, agent))
    sort(queue.heap)
    for rank in range(queue.turn.size):
        queue.turn[rank] = agent_of(queue.heap[rank])
        queue.order[queue.turn[rank]] = rank


@kernel
def _negotiate(run: HostRun, fields: DistanceFields, plan: HostNegotiation) -> None:
    """Run rounds of planning until every agent holds a reservation or the rounds are used up.

    The paths and how much of them is reserved are left in `plan.reservations`.
    """
    agents, queue, reservations, width = run.agents, plan.queue, plan.reservations, run.grid.width
    window = plan.work.mark.shape[0] - 1
    clear(reservations, run.grid)
    for agent in range(agents.position.size):
        for t in range(window + 1):
            reservations.path[agent, t] = agents.paths[agent, t]
        reserve(reservations, agent, plan.remembered_steps, width)
        queue.attempts[agent] = 0
        queue.heap[agent] = -agent  # in order of urgency: a heap already
    queue.size[()] = agents.position.size
    for turn in range(plan.rounds):
        count = min(queue.size[()], queue.planning.size)
        if count == 0 or fields.is_full[()]:
            break
        for lane in range(count):
            queue.planning[lane] = queue.turn[-queue.heap[0] % queue.turn.size]
            queue.size[()] -= 1
            queue.heap[0] = queue.heap[queue.size[()]]
            sift(queue.heap, 0, queue.size[()])
        for lane in range(count):
            release(reservations, queue.planning[lane], width)
        for lane in range(count):
            _plan(run, fields, plan, lane, turn)
        _choose(queue, reservations, count)
        # Whoever is not chosen queues again, and so do those whose reservations are driven over.
        for lane in range(count):
            if queue.is_chosen[0, lane]:
                _evict(plan, queue.planning[lane], width)
            else:
                _wait(queue, queue.planning[lane])
        for lane in range(count):
            if queue.is_chosen[0, lane]:
                reserve(reservations, queue.planning[lane], window, width)


@formula
def _plan(
    run: HostRun, fields: DistanceFields, plan: HostNegotiation, lane: int, turn: int
) -> None:
    """Let one agent plan."""
    agents, grid, queue = run.agents, run.grid, plan.queue
    number = queue.planning[lane]
    first, second = agents.goal[0, number], agents.goal[1, number]
    attempt = rules.penalty_index(queue.attempts[number], plan.penalties.size)
    kind, kinds = agents.kind[number], grid.service_time.size
    agent = Agent(
        agents.position[number],
        (first, second),
        (grid.goals[first], grid.goals[second]),
        (grid.service_time[kind], grid.service_time[(kind + 1) % kinds]),
        agents.remaining_service[number],
        capped_penalty(plan.penalties[attempt], plan.work.side // 2),
        rules.tie_break_of_round(queue.tie_break[number], turn),
    )
    code = find_path(plan.work, plan.reservations, fields, grid, agent)
    queue.is_found[lane] = code >= 0
    if code >= 0:
        trace(plan.work, plan.reservations, grid, agent, code, number)
    queue.attempts[number] += 1


@formula
def _choose(queue: Queue, reservations: ReservationWords, count: int) -> None:
    """Choose, of the paths that were found, those that conflict with no earlier chosen one.

    The greedy choice in `rules.SWEEPS` sweeps over all at once.
    """
    chosen, conflict = queue.is_chosen, queue.conflict
    for lane in range(count):
        chosen[0, lane] = queue.is_found[lane]
        for other in range(lane):
            both = queue.is_found[lane] and queue.is_found[other]
            conflict[lane, other] = both and _in_conflict(
                reservations.path, queue.planning[lane], queue.planning[other]
            )
    for _ in range(rules.SWEEPS):
        for lane in range(count):
            chosen[1, lane] = queue.is_found[lane]
            for other in range(lane):
                chosen[1, lane] &= not (conflict[lane, other] and chosen[0, other])
        for lane in range(count):
            chosen[0, lane] = chosen[1, lane]


@formula
def _in_conflict(path: np.ndarray, ours: int, theirs: int) -> bool:
    """Return True if two agents' paths have a vertex or swap conflict after their first cell."""
    for t in range(1, path.shape[1]):
        if rules.steps_conflict(
            path[ours, t - 1], path[ours, t], path[theirs, t - 1], path[theirs, t]
        ):
            return True
    return False


@formula
def _evict(plan: HostNegotiation, agent: int, width: int) -> None:
    """Release all agents whose reservations an agent's path drives over."""
    reservations, window = plan.reservations, plan.work.mark.shape[0] - 1
    for t in range(window):
        before, after = reservations.path[agent, t], reservations.path[agent, t + 1]
        for swap in range(2):
            if swap:
                met = swapped_with(reservations, before, after, t, width)
            else:
                met = holder(reservations, after, t)
            if met != NOBODY:
                if reservations.steps[met] == window:  # else it never left the queue
                    _wait(plan.queue, met)
                release(reservations, met, width)


@kernel
def _wait(queue: Queue, agent: int) -> None:
    """Put an agent into the queue."""
    heap, hole = queue.heap, queue.size[()]
    urgency = -rules.urgency(queue.order[agent], queue.attempts[agent], queue.turn.size)
    queue.size[()] += 1
    while hole > 0 and heap[(hole - 1) // 2] < urgency:
        heap[hole] = heap[(hole - 1) // 2]
        hole = (hole - 1) // 2
    heap[hole] = urgency
