"""A slow, plain search for one agent's best path: what the negotiated planner has to compute.

It knows nothing of words and bits: a uniform-cost search over every state there is (time,
conflicts, cell, leg, timesteps served), on a small maze with corridors and a hall.
"""

import heapq
import itertools
from typing import NamedTuple

import numpy as np

from qdenv.grid import parse
from qdenv.simulate.mapf.negotiated.rules import COST_UNIT
from qdenv.simulate.mapf.planner import UNREACHABLE

WINDOW = 6
MOVES = ((0, 0), (0, 1), (0, -1), (1, 0), (-1, 0))
MAZE = parse(
    ["....#....", ".##...##.", ".#..#..#.", "...###...", ".#..#..#.", ".##...##.", "....#...."],
    ".#",
)
FREE = MAZE == 0
HEIGHT, WIDTH = FREE.shape


class Case(NamedTuple):
    """One agent among others."""

    start: int  # its cell
    goals: tuple[int, int]  # cells of its current and next goal
    services: tuple[int, int]  # timesteps to serve at each
    serving: int  # timesteps still to serve at the start; 0 while driving
    others: np.ndarray  # int [WINDOW + 1, n], paths of the others, without conflicts
    penalty: int  # cost of a conflict
    levels: int  # conflict levels


def numpy_distances(free: np.ndarray, goal: int) -> np.ndarray:
    """Breadth-first search, one cell at a time."""
    height, width = free.shape
    distance = np.full(height * width, UNREACHABLE)
    distance[goal] = 0
    queue = [goal]
    for cell in queue:
        for down, right in MOVES[1:]:
            row, column = cell // width + down, cell % width + right
            if 0 <= row < height and 0 <= column < width and free[row, column]:
                other = row * width + column
                if distance[other] == UNREACHABLE:
                    distance[other] = distance[cell] + 1
                    queue.append(other)
    return distance


def random_case(rng: np.random.Generator, number: int, services: tuple[int, int]) -> Case:
    """Draw a case; some begin on their goal, some in service."""
    others = random_walks(rng, 12)
    cells = np.flatnonzero(FREE)
    start = int(rng.choice(np.setdiff1d(cells, others[0])))
    first, second = (int(goal) for goal in rng.choice(cells, 2))
    serving = int(rng.integers(1, services[0] + 1)) if services[0] and number % 3 == 0 else 0
    if serving or number % 5 == 0:
        first = start
    penalty = int(rng.choice([2, 6, 40]))
    return Case(start, (first, second), services, serving, others, penalty, 3)


def random_walks(rng: np.random.Generator, count: int) -> np.ndarray:
    """Draw paths that never conflict, one after the other (int [WINDOW + 1, count])."""
    paths: list[list[int]] = []
    while len(paths) < count:
        path = [int(rng.choice(np.flatnonzero(FREE)))]
        for _ in range(WINDOW):
            ways = [path[-1] + down * WIDTH + right for down, right in MOVES]
            ways = [way for way in ways if is_step(path[-1], way)]
            path.append(int(rng.choice(ways)))
        others = np.array(paths, int).reshape(-1, WINDOW + 1).T
        steps = enumerate(itertools.pairwise(path))
        if path[0] not in others[0] and not any(hits(others, t, a, b) for t, (a, b) in steps):
            paths.append(path)
    return np.array(paths).T


def is_step(here: int, there: int) -> bool:
    """Tell whether an agent can go from `here` to `there` in one timestep."""
    near = abs(here // WIDTH - there // WIDTH) + abs(here % WIDTH - there % WIDTH) <= 1
    return 0 <= there < HEIGHT * WIDTH and near and bool(FREE.reshape(-1)[there])


def hits(others: np.ndarray, time: int, here: int, there: int) -> bool:
    """Tell whether the step from `here` to `there` conflicts with one of the paths."""
    met = (others[time + 1] == there).any()
    swapped = ((others[time] == there) & (others[time + 1] == here)).any() and here != there
    return bool(met or swapped)


def cheapest(case: Case) -> int:
    """Find the cost of the best path by uniform-cost search over every state there is."""
    start, goals, services, serving, others, penalty, levels = case
    distance = [numpy_distances(FREE, goal) for goal in goals]
    between = int(distance[1][goals[0]])
    seen, best = set(), 10**9
    queue = [(0, 0, start, 0, services[0] - serving if serving else -1)]
    while queue:
        state = heapq.heappop(queue)
        if state in seen:
            continue
        seen.add(state)
        time, conflicts, cell, leg, elapsed = state
        if time == WINDOW:
            left = max(services[leg] - elapsed, 0)
            if elapsed < 0:
                left = int(distance[leg][cell]) + services[leg]
            cost = left + (between + services[1] if leg == 0 else 0)
            best = min(best, COST_UNIT * cost + conflicts * penalty)
            continue
        ways = [cell] if elapsed >= 0 else [cell + d * WIDTH + r for d, r in MOVES]
        for there in ways:
            if not is_step(cell, there):
                continue
            more = min(conflicts + hits(others, time, cell, there), levels - 1)
            now, at = leg, elapsed + 1 if elapsed >= 0 else -1
            if at < 0 and there == goals[now] and (now == 0 or services[1] > 0):
                at = 0
            if now == 0 and at == services[0]:
                now, at = 1, -1
            heapq.heappush(queue, (time + 1, more, there, now, at))
    return best


def cost_of(case: Case, path: np.ndarray) -> int:
    """Drive a path (int [WINDOW + 1]) by the rules and price it; refuse what breaks one."""
    start, goals, services, serving, others, penalty, levels = case
    assert path[0] == start
    assert all(is_step(a, b) for a, b in itertools.pairwise(path.tolist()))
    distance = [numpy_distances(FREE, goal) for goal in goals]
    leg, left, conflicts = 0, serving, 0
    for time, (here, there) in enumerate(itertools.pairwise(path.tolist())):
        conflicts = min(conflicts + hits(others, time, here, there), levels - 1)
        if left > 0:
            assert here == there, "a service is cut short"
            left -= 1
            leg += left == 0
        elif leg < 2 and there == goals[leg] and (leg == 0 or services[1]):
            left = services[leg]
            leg += left == 0
    after = distance[1][goals[0]] + services[1]
    if left > 0:
        rest = left + (after if leg == 0 else 0)
    else:
        rest = (
            distance[0][path[-1]] + services[0] + after,
            distance[1][path[-1]] + services[1],
            0,
        )[leg]
    return COST_UNIT * int(rest) + conflicts * penalty
