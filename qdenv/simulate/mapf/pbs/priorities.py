"""Who has precedence over whom: a partial order that grows and shrinks by one pair at a time."""

from typing import NamedTuple

import numpy as np

from qdenv.native import formula, kernel
from qdenv.simulate.mapf.planner import NOBODY

UP, DOWN = 0, 1  # from an agent to those above it, or to those below
PAIRS, MARK = range(2)  # entries of `Priorities.number`


class Priorities(NamedTuple):
    """The pairs of the branch of the search tree that is in hand, as a graph; D pairs, A agents."""

    end: np.ndarray  # int32 [2, D], the agent above and the agent below of each pair
    following: np.ndarray  # int32 [2, D], the next pair of the same agent in either direction
    first: np.ndarray  # int32 [2, A], the first pair of each agent in either direction, or `NOBODY`
    mark: np.ndarray  # int64 [2, A], who was found by the last walk up, or down
    stack: np.ndarray  # int32 [A], agents whose pairs are still to be looked at
    number: np.ndarray  # int64 [2], how many pairs there are, and the mark of the last walk


def make_priorities(agents: int, pairs: int) -> Priorities:
    """Make room for so many pairs."""
    end, following = np.zeros((2, 2, pairs), np.int32)
    first, mark = np.full((2, agents), NOBODY, np.int32), np.zeros((2, agents), np.int64)
    return Priorities(
        end, following, first, mark, np.zeros(agents, np.int32), np.zeros(2, np.int64)
    )


@formula
def forget_priorities(order: Priorities) -> None:
    """Begin with no priorities."""
    order.first[:] = NOBODY
    order.number[PAIRS] = 0


@kernel
def put_above(order: Priorities, high: int, low: int) -> None:
    """Give one agent precedence over another."""
    pair = order.number[PAIRS]
    order.end[UP, pair], order.end[DOWN, pair] = high, low
    order.following[UP, pair], order.first[UP, low] = order.first[UP, low], pair
    order.following[DOWN, pair], order.first[DOWN, high] = order.first[DOWN, high], pair
    order.number[PAIRS] += 1


@kernel
def take_back(order: Priorities) -> None:
    """Take the last pair back."""
    order.number[PAIRS] -= 1
    pair = order.number[PAIRS]
    high, low = order.end[UP, pair], order.end[DOWN, pair]
    order.first[UP, low] = order.following[UP, pair]
    order.first[DOWN, high] = order.following[DOWN, pair]


@kernel
def walk(order: Priorities, agent: int, direction: int) -> None:
    """Find all agents above (or below) one, through any number of pairs; `is_found` tells."""
    order.number[MARK] += 1
    mark, count = order.number[MARK], 1
    order.stack[0] = agent
    while count > 0:
        count -= 1
        pair = order.first[direction, order.stack[count]]
        while pair != NOBODY:
            other = order.end[direction, pair]
            if order.mark[direction, other] != mark:
                order.mark[direction, other] = mark
                order.stack[count] = other
                count += 1
            pair = order.following[direction, pair]


@formula
def is_found(order: Priorities, agent: int, direction: int, mark: int) -> bool:
    """Tell whether a walk found an agent."""
    return order.mark[direction, agent] == mark
