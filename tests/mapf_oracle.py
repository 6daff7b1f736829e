"""A slow, plain search for one agent's best path: what the negotiated planner has to compute.

It knows nothing of words and bits: a uniform-cost search over every state there is (time,
conflicts, cell, leg, timesteps served), on a small maze with corridors and a hall.
"""

import itertools
from typing import NamedTuple

import numpy as np
from maze_oracle import bfs

from qdenv.grid import parse
from qdenv.simulation.mapf.negotiated.settings import COST_UNIT, MOVE_UNIT
from qdenv.simulation.mapf.planner import UNREACHABLE, UNREACHABLE_COST

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
    # int [5, cells], the cost of each move from each cell, 0 where it is not allowed; None without
    costs: np.ndarray | None = None

    @property
    def unit(self) -> int:
        """The cost of a timestep."""
        return COST_UNIT if self.costs is None else MOVE_UNIT

    def price(self, here: int, there: int) -> int:
        """Price a step; without costs time is no cost. Refuse one that is not allowed."""
        if self.costs is None:
            return 0
        move = MOVES.index((there // WIDTH - here // WIDTH, there % WIDTH - here % WIDTH))
        return int(self.costs[move, here])

    def allows(self, here: int, there: int) -> bool:
        """Tell whether an agent can go from `here` to `there` in one timestep."""
        return is_step(here, there) and (self.costs is None or self.price(here, there) > 0)

    def to_go(self) -> list[np.ndarray]:
        """Measure what is left from each cell to both goals (int [cells] each)."""
        if self.costs is None:
            return [COST_UNIT * numpy_distances(FREE, goal) for goal in self.goals]
        steps = {(a, b) for a in range(FREE.size) for b in range(FREE.size) if self.allows(a, b)}
        left = np.full((2, FREE.size), UNREACHABLE_COST)
        left[[0, 1], self.goals] = 0
        before = None
        while before is None or (before != left).any():
            before = left.copy()
            for here, there in steps:
                if here != there:
                    left[:, here] = np.minimum(
                        left[:, here], self.price(here, there) + left[:, there]
                    )
        return list(left)


def numpy_distances(free: np.ndarray, goal: int) -> np.ndarray:
    """Count the steps from all cells to a goal, by the breadth-first search of the mazes."""
    steps = bfs(~free, goal)
    distance = np.full(free.size, UNREACHABLE)
    distance[[*steps]] = [*steps.values()]
    return distance


def random_case(
    rng: np.random.Generator, number: int, services: tuple[int, int], has_costs: bool = False
) -> Case:
    """Draw a case; some begin on their goal, some in service."""
    others = random_walks(rng, 12)
    cells = np.flatnonzero(FREE)
    start = int(rng.choice(np.setdiff1d(cells, others[0])))
    first, second = (int(goal) for goal in rng.choice(cells, 2))
    serving = int(rng.integers(1, services[0] + 1)) if services[0] and number % 3 == 0 else 0
    if serving or number % 5 == 0:
        first = start
    penalty = int(rng.choice([2, 6, 40]))
    case = Case(start, (first, second), services, serving, others, penalty, 3)
    if not has_costs:
        return case
    # Few numbers, so that there are ties, and a wide range of them; one move in ten is forbidden.
    costs = rng.choice([1, 64, 64, 80, 1023], (len(MOVES), FREE.size))
    costs[1:][rng.random(costs[1:].shape) < 0.1] = 0
    return case._replace(penalty=16 * penalty, costs=costs)


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
    start, goals, services, serving, others, penalty, levels, _ = case
    left_to, unit = case.to_go(), case.unit
    between = int(left_to[1][goals[0]])
    # Conflicts, cell, leg and timesteps served (-1 while driving): what the cheapest path cost.
    reached = {(0, start, 0, services[0] - serving if serving else -1): 0}
    for time in range(WINDOW):
        later: dict[tuple[int, int, int, int], int] = {}
        for (conflicts, cell, leg, elapsed), spent in reached.items():
            ways = [cell] if elapsed >= 0 else [cell + d * WIDTH + r for d, r in MOVES]
            for there in ways:
                if not case.allows(cell, there):
                    continue
                more = min(conflicts + hits(others, time, cell, there), levels - 1)
                now, at = leg, elapsed + 1 if elapsed >= 0 else -1
                price = case.price(cell, there)
                if elapsed >= 0:
                    serves = elapsed < services[leg] and case.costs is not None
                    price = unit if serves else price
                if at < 0 and there == goals[now] and (now == 0 or services[1] > 0):
                    at = 0
                if now == 0 and at == services[0]:
                    now, at = 1, -1
                state = (more, there, now, at)
                later[state] = min(later.get(state, 10**9), spent + price)
        reached = later
    best = 10**9
    for (conflicts, cell, leg, elapsed), spent in reached.items():
        left = unit * max(services[leg] - elapsed, 0)
        if elapsed < 0:
            left = int(left_to[leg][cell]) + unit * services[leg]
        left += between + unit * services[1] if leg == 0 else 0
        best = min(best, spent + left + conflicts * penalty)
    return best


def cost_of(case: Case, path: np.ndarray) -> int:
    """Drive a path (int [WINDOW + 1]) by the rules and price it; refuse what breaks one."""
    start, goals, services, serving, others, penalty, levels, _ = case
    assert path[0] == start
    assert all(case.allows(a, b) for a, b in itertools.pairwise(path.tolist()))
    left_to, unit, spent = case.to_go(), case.unit, 0
    leg, left, conflicts = 0, serving, 0
    for time, (here, there) in enumerate(itertools.pairwise(path.tolist())):
        conflicts = min(conflicts + hits(others, time, here, there), levels - 1)
        serves = left > 0 and case.costs is not None
        spent += unit if serves else case.price(here, there)
        if left > 0:
            assert here == there, "a service is cut short"
            left -= 1
            leg += left == 0
        elif leg < 2 and there == goals[leg] and (leg == 0 or services[1]):
            left = services[leg]
            leg += left == 0
    after = left_to[1][goals[0]] + unit * services[1]
    if left > 0:
        rest = unit * left + (after if leg == 0 else 0)
    else:
        rest = (
            left_to[0][path[-1]] + unit * services[0] + after,
            left_to[1][path[-1]] + unit * services[1],
            0,
        )[leg]
    return int(rest + spent) + conflicts * penalty
