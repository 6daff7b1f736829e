"""Guidance from tasks that are planned one after the other, each along its cheapest way.

A way makes the moves against it dear and, for highways, those along it cheap, so later tasks
bundle into lanes. Agents and collisions are no part of it. The baselines of Zhang et al. 2024
(https://arxiv.org/abs/2402.01446, https://github.com/lunjohnzhang/ggo_public), with their numbers.
"""

import heapq

import numpy as np

from qdenv.grid import NUM_MOVES, move_steps
from qdenv.native import compiled

_TASKS = 100_000  # planned in turn, as published
_SEED = 0
_ALONG, _AGAINST, _FULL = 0.5, 1.2, 1.3  # alpha, beta and gamma of Cohen et al. 2016
# The cheapest seventh of all moves may be highways; a random fifth of these are.
_CANDIDATES, _HIGHWAYS, _HIGHWAY = 1 / 7, 1 / 5, 0.5
_CHEAPEST, _DEAREST = 0.1, 100.0  # costs after scaling; waiting costs 1


def traffic_flow(traversable: np.ndarray, legs: np.ndarray) -> np.ndarray:
    """Charge moves for opposite traffic and for crowds where they lead.

    Chen et al. 2024, "Traffic flow optimisation for lifelong multi-agent path finding"
    (https://arxiv.org/abs/2308.11234): the price of moving from u to v is 1 + f(u, v) f(v, u) +
    ceil((n(v) - 1) / 2) with f the tasks that move that way and n those that come to a cell.
    `legs` is float [L, 2, H, W], the odds of each cell to be the start and the end of a task, for
    each kind of task. Returns float [5, H, W].
    """
    prices, moves = _plan(traversable, legs, contraflow=True)
    low, high = prices[moves].min(initial=np.inf), prices[moves].max(initial=0)
    scale = (_DEAREST - _CHEAPEST) / max(high - low, 1e-9)
    costs = np.ones((NUM_MOVES, *traversable.shape))
    costs[moves] = _CHEAPEST + scale * (prices[moves] - low)
    return costs


def human_cost(traversable: np.ndarray, legs: np.ndarray) -> np.ndarray:
    """Halve the cost of some of the moves that tasks make the most, and not the other way.

    The heat maps ("HM") of Cohen et al. 2016, "Improved solvers for bounded-suboptimal multi-agent
    path finding", IJCAI: the price of moving from u to v is 1 - alpha f(u, v) + beta f(v, u) +
    gamma^((f(u, v) + f(v, u)) / 2) with f the share of all tasks that move that way. `legs` as in
    `traffic_flow`. Returns float [5, H, W].
    """
    prices, moves = _plan(traversable, legs, contraflow=False)
    order = np.argsort(prices[moves], kind="stable")[: int(_CANDIDATES * moves.sum())]
    rng = np.random.default_rng(_SEED)
    chosen = rng.choice(order, int(_HIGHWAYS * len(order)), replace=False)
    costs = np.ones((NUM_MOVES, *traversable.shape))
    costs.flat[np.flatnonzero(moves)[chosen]] = _HIGHWAY
    return costs


def _plan(
    traversable: np.ndarray, legs: np.ndarray, contraflow: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Plan all tasks; return the prices of moves at the end, and which moves exist ([5, H, W])."""
    rng, free = np.random.default_rng(_SEED), np.pad(traversable, 1)
    kinds = rng.integers(len(legs), size=_TASKS)
    ends = np.empty((2, _TASKS), np.int64)
    for kind, odds in enumerate(legs):
        padded = [np.pad(np.where(traversable, one, 0), 1).reshape(-1) for one in odds]
        chosen = np.flatnonzero(kinds == kind)
        for end, weight in zip(ends, padded, strict=True):
            end[chosen] = rng.choice(weight.size, chosen.size, p=weight / weight.sum())
    prices = _price(free.reshape(-1), move_steps(free.shape[1]), ends, contraflow)
    prices = prices.reshape(NUM_MOVES, *free.shape)[:, 1:-1, 1:-1]
    return prices, np.isfinite(prices)


@compiled
def _price(free: np.ndarray, steps: np.ndarray, ends: np.ndarray, contraflow: bool) -> np.ndarray:
    """Plan tasks on a walled grid, bool [N], all of whose free cells hang together.

    `steps` is what moves add to a cell, `ends` int [2, tasks] are the cells where tasks start and
    end. Returns the prices of moves, float [5, N], infinite where there is none, and for waiting.
    """
    tasks = ends.shape[1]
    uses, visits = np.zeros((NUM_MOVES, free.size), np.int64), np.zeros(free.size, np.int64)
    prices = np.full((NUM_MOVES, free.size), np.inf)
    distance, reached_by = np.empty(free.size), np.empty(free.size, np.int64)
    for cell in np.flatnonzero(free):
        for move in range(1, NUM_MOVES):
            if free[cell + steps[move]]:
                prices[move, cell] = 1.0 if contraflow else 2.0  # as without any traffic
    for task in range(tasks):
        begin, end = ends[0, task], ends[1, task]
        # Dijkstra 1959
        distance[:] = np.inf
        distance[begin] = 0.0
        queue = [(0.0, begin)]
        while queue:
            cost, cell = heapq.heappop(queue)
            if cell == end:
                break
            if cost > distance[cell]:
                continue
            for move in range(1, NUM_MOVES):
                other = cell + steps[move]
                if cost + prices[move, cell] < distance[other]:
                    distance[other], reached_by[other] = cost + prices[move, cell], move
                    heapq.heappush(queue, (distance[other], other))
        cell = end
        visits[cell] += 1
        while cell != begin:
            move = reached_by[cell]
            cell -= steps[move]
            uses[move, cell] += 1
            visits[cell] += 1
        # What the way changed: the costs of all moves from its cells and to them.
        cell = end
        while True:
            for move in range(1, NUM_MOVES):
                # The table of moves lists each direction beside its opposite.
                other, back = cell + steps[move], move + 1 if move % 2 == 1 else move - 1
                if free[other]:
                    one, two = uses[move, cell], uses[back, other]
                    if contraflow:
                        prices[move, cell] = 1.0 + one * two + np.ceil((visits[other] - 1) / 2)
                        prices[back, other] = 1.0 + one * two + np.ceil((visits[cell] - 1) / 2)
                    else:
                        full = 1.0 + _FULL ** ((one + two) / (2 * tasks))
                        prices[move, cell] = full + (_AGAINST * two - _ALONG * one) / tasks
                        prices[back, other] = full + (_AGAINST * one - _ALONG * two) / tasks
            if cell == begin:
                break
            cell -= steps[reached_by[cell]]
    return prices
