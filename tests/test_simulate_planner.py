"""The windowed planner: one agent against a slow oracle, reservations, joint plans."""

import heapq
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qdenv.grid import parse
from qdenv.simulate.mapf.distances import UNREACHABLE, goal_distances
from qdenv.simulate.mapf.metrics import MARGIN, walled
from qdenv.simulate.mapf.negotiated.xla import bitplanes as reservation
from qdenv.simulate.mapf.negotiated.xla import search as single_agent
from qdenv.simulate.mapf.negotiated.xla.window import REACH, UNIT, View
from qdenv.simulate.mapf.planner import first_of_each_clash

WINDOW = 6
MOVES = ((0, 0), (0, 1), (0, -1), (1, 0), (-1, 0))
MAZE = parse(
    [
        "....#....",
        ".##...##.",
        ".#..#..#.",
        "...###...",
        ".#..#..#.",
        ".##...##.",
        "....#....",
    ],
    ".#",
)
FREE = MAZE == 0
HEIGHT, WIDTH = FREE.shape
WALLED = (HEIGHT + 2 * MARGIN, WIDTH + 2 * MARGIN)


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


def random_walks(rng: np.random.Generator, count: int) -> np.ndarray:
    """Draw paths that never conflict, one after the other (int [WINDOW + 1, count])."""
    paths: list[list[int]] = []
    while len(paths) < count:
        path = [int(rng.choice(np.flatnonzero(FREE)))]
        for _ in range(WINDOW):
            ways = [path[-1] + down * WIDTH + right for down, right in MOVES]
            ways = [w for w in ways if _is_step(path[-1], w)]
            path.append(int(rng.choice(ways)))
        others = np.array(paths, int).reshape(-1, WINDOW + 1).T
        steps = enumerate(itertools.pairwise(path))
        if path[0] not in others[0] and not any(hits(others, t, a, b) for t, (a, b) in steps):
            paths.append(path)
    return np.array(paths).T


def _is_step(a: int, b: int) -> bool:
    near = abs(a // WIDTH - b // WIDTH) + abs(a % WIDTH - b % WIDTH) <= 1
    return 0 <= b < HEIGHT * WIDTH and near and bool(FREE.reshape(-1)[b])


def hits(others: np.ndarray, time: int, here: int, there: int) -> bool:
    """Tell whether the step from `here` to `there` conflicts with one of the paths."""
    met = (others[time + 1] == there).any()
    swapped = ((others[time] == there) & (others[time + 1] == here)).any() and here != there
    return bool(met or swapped)


def cheapest(
    start: int,
    goals: tuple[int, int],
    stays: tuple[int, int],
    serving: int,
    others: np.ndarray,
    penalty: int,
    layers: int,
) -> int:
    """Find the price of the best path by uniform-cost search over every state there is."""
    distance = [numpy_distances(FREE, goal) for goal in goals]
    between = int(distance[1][goals[0]])
    seen, queue, best = set(), [(0, 0, start, 0, stays[0] - serving if serving else -1)], 10**9
    while queue:
        state = heapq.heappop(queue)
        if state in seen:
            continue
        seen.add(state)
        time, layer, cell, level, elapsed = state
        if time == WINDOW:
            todo = max(stays[level] - elapsed, 0) if elapsed >= 0 else None
            if todo is None:
                todo = int(distance[level][cell]) + stays[level]
            price = todo + (between + stays[1] if level == 0 else 0)
            best = min(best, UNIT * price + layer * penalty)
            continue
        ways = [cell] if elapsed >= 0 else [cell + d * WIDTH + r for d, r in MOVES]
        for there in ways:
            if not _is_step(cell, there):
                continue
            worse = min(layer + hits(others, time, cell, there), layers - 1)
            now, at = level, elapsed + 1 if elapsed >= 0 else -1
            if at < 0 and there == goals[now] and (now == 0 or stays[1] > 0):
                at = 0
            if now == 0 and at == stays[0]:
                now, at = 1, -1
            heapq.heappush(queue, (time + 1, worse, there, now, at))
    return best


def view_of(start: int, goals: tuple[int, int], stays: tuple[int, int], serving: int, others):
    """Build what one agent sees, by hand."""
    table = reservation.empty(WINDOW, *WALLED)
    paths = jnp.asarray(walled(jnp.asarray(others), WIDTH), jnp.int32)
    mask = jnp.ones(others.shape[1], bool)
    table = reservation.reserve(table, paths, mask, WALLED)
    table = table.reshape(WINDOW, reservation.PLANES, WALLED[0], -1)
    free = reservation.pack(jnp.pad(jnp.asarray(FREE), MARGIN))
    position = walled(jnp.array([start]), WIDTH)
    reach = REACH
    side = 2 * reach + 1
    price = np.full((2, side, side, 1), 10**5, np.int32)
    bits = np.zeros((2, side, 1), np.uint32)
    distance = [numpy_distances(FREE, goal) for goal in goals]
    tail = UNIT * (int(distance[1][goals[0]]) + stays[1])
    spot = np.zeros((2, 2, 1), np.int32)
    for level in range(2):
        for cell in range(HEIGHT * WIDTH):
            row, column = cell // WIDTH - start // WIDTH, cell % WIDTH - start % WIDTH
            todo = UNIT * (int(distance[level][cell]) + stays[level])
            price[level, row + reach, column + reach] = todo + (tail if level == 0 else 0)
        if level == 0 or stays[1] > 0:
            row = goals[level] // WIDTH - start // WIDTH + reach
            column = goals[level] % WIDTH - start % WIDTH + reach
            bits[level, row, 0] = 1 << column
            spot[:, level, 0] = row, column
    return {
        "taken": reservation.around(table, position, WALLED[1], reach),
        "free": reservation.around(free, position, WALLED[1], reach),
        "goal": jnp.asarray(bits),
        "goal_row": jnp.asarray(spot[0]),
        "goal_column": jnp.asarray(spot[1]),
        "price": jnp.asarray(price),
        "tail": jnp.array([tail]),
        "stay": jnp.array(stays)[:, None],
        "serving": jnp.array([serving]),
    }


PLAN = jax.jit(single_agent.plan, static_argnums=1)


@pytest.mark.parametrize("stays", [(0, 0), (2, 3), (0, 2), (3, 0)])
def test_one_agent_agrees_with_uniform_cost_search(stays: tuple[int, int]):
    rng = np.random.default_rng(sum(stays))
    cells = np.flatnonzero(FREE)
    for case in range(25):
        others = random_walks(rng, 12)
        start = int(rng.choice(np.setdiff1d(cells, others[0])))
        goals = tuple(int(goal) for goal in rng.choice(cells, 2))
        goals = (start, goals[1]) if case % 5 == 0 else goals
        serving = int(rng.integers(1, stays[0] + 1)) if stays[0] and case % 3 == 0 else 0
        if serving:
            goals = (start, goals[1])
        penalty, layers = int(rng.choice([2, 6, 40])), 3
        fields = view_of(start, goals, stays, serving, others)
        extra = {"penalty": jnp.array([penalty]), "noise": jnp.array([case * 977])}
        steps, price = PLAN(View(**fields, **extra), layers)
        assert int(price[0]) == cheapest(start, goals, stays, serving, others, penalty, layers)
        path = start + np.asarray(steps)[0, :, 0] * WIDTH + np.asarray(steps)[1, :, 0]
        assert path[0] == start
        assert all(_is_step(a, b) for a, b in itertools.pairwise(path))
        check_path_price(path, goals, stays, serving, others, penalty, layers, int(price[0]))


def check_path_price(path, goals, stays, serving, others, penalty, layers, price):
    """Drive the path and see that it is worth what the planner said."""
    distance = [numpy_distances(FREE, goal) for goal in goals]
    level, left, over = 0, serving, 0
    for time in range(WINDOW):
        here, there = int(path[time]), int(path[time + 1])
        over = min(over + hits(others, time, here, there), layers - 1)
        if left > 0:
            assert here == there, "a stay is cut short"
            left -= 1
            level += left == 0
        elif level < 2 and there == goals[level] and (level == 0 or stays[1]):
            left = stays[level]
            level += left == 0
    todo = [distance[0][path[-1]] + stays[0] + distance[1][goals[0]] + stays[1]]
    todo += [distance[1][path[-1]] + stays[1], 0]
    if left > 0:
        todo = [left + distance[1][goals[0]] + stays[1], left]
    assert price == UNIT * int(todo[level]) + over * penalty


def test_reservations_are_seen_where_they_are_and_vanish_when_removed():
    rng = np.random.default_rng(3)
    others = random_walks(rng, 10)
    paths = walled(jnp.asarray(others), WIDTH).astype(jnp.int32)
    mask = jnp.ones(10, bool)
    table = reservation.reserve(reservation.empty(WINDOW, *WALLED), paths, mask, WALLED)
    reach = REACH
    for cell in np.flatnonzero(FREE):
        shaped = table.reshape(WINDOW, reservation.PLANES, WALLED[0], -1)
        seen = reservation.around(shaped, walled(jnp.array([cell]), WIDTH), WALLED[1], reach)
        centre = (np.asarray(seen)[:, :, reach, 0] >> reach) & 1
        taken = (others[1:] == cell).any(1)
        assert (centre[:, 0] == taken).all()
        for plane, (down, right) in enumerate(MOVES[1:], start=1):
            leaving = (others[:-1] == cell) & (others[1:] == cell + down * WIDTH + right)
            assert (centre[:, plane] == leaving.any(1)).all()
    assert not reservation.reserve(table, paths, mask, WALLED, sign=-1).any()


def test_distances_agree_with_plain_search():
    free = jnp.asarray(FREE).at[3, 3].set(False)
    cells = np.flatnonzero(np.asarray(free))[:40]
    padded = jnp.zeros(64, jnp.int32).at[:40].set(cells)
    distance = np.asarray(jax.jit(goal_distances)(free, padded, jnp.arange(64) < 40))
    for slot, cell in enumerate(cells):
        np.testing.assert_array_equal(distance[slot], numpy_distances(np.asarray(free), cell))
    assert (distance[40:] == UNREACHABLE).all()


def test_long_ways_are_counted_in_full():
    snake = ["." * 9 if row % 2 == 0 else "#" * 8 + "." for row in range(9)]
    snake = [row if index % 4 != 3 else row[::-1] for index, row in enumerate(snake)]
    free = parse(snake, ".#") == 0
    measured = goal_distances(jnp.asarray(free), jnp.array([0]), jnp.array([True]))
    expected = numpy_distances(free, 0)
    assert expected[free.reshape(-1)].max() == 48
    np.testing.assert_array_equal(np.asarray(measured)[0], expected)


def test_chosen_candidates_never_clash():
    rng = np.random.default_rng(0)
    for _ in range(20):
        clash = rng.random((12, 12)) < 0.2
        clash |= clash.T
        candidates = rng.random(12) < 0.8
        chosen = np.asarray(first_of_each_clash(jnp.asarray(clash), jnp.asarray(candidates)))
        assert not (chosen & ~candidates).any()
        assert not (clash & ~np.eye(12, dtype=bool))[np.ix_(chosen, chosen)].any()
        assert chosen.any() or not candidates.any()
