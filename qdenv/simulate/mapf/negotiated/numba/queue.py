"""Who plans next: the agents without a whole reserved path, by urgency."""

from typing import NamedTuple

import numpy as np

from qdenv.native import formula, kernel
from qdenv.simulate.mapf import chance
from qdenv.simulate.mapf.host.crew import Crew
from qdenv.simulate.mapf.host.order import agent_of, ranked, sort
from qdenv.simulate.mapf.negotiated import rules


class Queue(NamedTuple):
    """Who holds no whole path, the most urgent first, and who plans in this round."""

    heap: np.ndarray  # int64 [A], the urgencies of those who wait, a binary heap
    size: np.ndarray  # int64 [1], how many wait
    order: np.ndarray  # int64 [A], the agents' luck of the draw
    turn: np.ndarray  # int64 [A], the agent of each place in that order
    noise: np.ndarray  # int64 [A], bits that settle ties
    attempts: np.ndarray  # int64 [A], how often each agent has planned in this window
    asking: np.ndarray  # int64 [lanes], who plans in this round
    is_found: np.ndarray  # bool [lanes], whether each found a path
    is_chosen: np.ndarray  # bool [2, lanes], whose path is taken, before and after a sweep
    conflict: np.ndarray  # bool [lanes, lanes], whose paths conflict


def make_queue(agents: int, lanes: int) -> Queue:
    """Make room for a queue of agents of whom `lanes` plan in a round."""
    return Queue(
        np.empty(agents, np.int64),
        np.zeros(1, np.int64),
        np.empty(agents, np.int64),
        np.empty(agents, np.int64),
        np.empty(agents, np.int64),
        np.empty(agents, np.int64),
        np.empty(lanes, np.int64),
        np.empty(lanes, np.bool_),
        np.empty((2, lanes), np.bool_),
        np.empty((lanes, lanes), np.bool_),
    )


@kernel
def draw_order(queue: Queue, crew: Crew, seed: int) -> None:
    """Draw the agents' order and the bits that settle ties, as `records.draw_priorities`."""
    order, ties = chance.mix(seed, chance.ORDER), chance.mix(seed, chance.TIES)
    for agent in range(queue.turn.size):
        serving = crew.remaining_service[agent] > 0
        queue.heap[agent] = ranked(rules.luck(chance.mix(order, agent), serving), agent)
        queue.noise[agent] = rules.noise_of(chance.mix(ties, agent))
    sort(queue.heap)
    for place in range(queue.turn.size):
        queue.turn[place] = agent_of(queue.heap[place])
        queue.order[queue.turn[place]] = place


@formula
def most_urgent(queue: Queue) -> int:
    """Take those who are first in turn out of the queue; returns how many."""
    count = min(queue.size[0], queue.asking.size)
    for lane in range(count):
        queue.asking[lane] = queue.turn[_pop(queue) % queue.turn.size]
    return count


@formula
def _pop(queue: Queue) -> int:
    """Take the smallest urgency out of the heap."""
    heap, smallest = queue.heap, queue.heap[0]
    queue.size[0] -= 1
    size, last, hole = queue.size[0], heap[queue.size[0]], 0
    while 2 * hole + 1 < size:
        child = 2 * hole + 1
        if child + 1 < size and heap[child + 1] < heap[child]:
            child += 1
        if heap[child] >= last:
            break
        heap[hole], hole = heap[child], child
    heap[hole] = last
    return smallest


@kernel
def wait(queue: Queue, agent: int) -> None:
    """Put an agent into the queue."""
    heap, hole = queue.heap, queue.size[0]
    urgency = rules.urgency(queue.order[agent], queue.attempts[agent], queue.turn.size)
    queue.size[0] += 1
    while hole > 0 and heap[(hole - 1) // 2] > urgency:
        heap[hole] = heap[(hole - 1) // 2]
        hole = (hole - 1) // 2
    heap[hole] = urgency
