"""What priority-based search has to compute, written slowly: tiny grids, plain Python.

One agent's best paths by looking at every state there is, joint plans by trying every priority
order and every choice among equally good paths, and a check of joint plans against the rules.
"""

import itertools
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from qdenv.grid import MOVES

FAR = 32_000  # steps to where no way leads
Path = tuple[int, ...]  # cells at timesteps 0, 1, ...; afterwards the agent is gone
Blocked = list[dict[int, int]]  # per timestep, whoever is told of: cell -> cell one step later


class Agent(NamedTuple):
    """One agent at the start of a window."""

    start: int  # its cell
    goals: tuple[int, int]  # cells of its current and of its next goal
    services: tuple[int, int]  # timesteps to serve at each
    serving: int  # timesteps still to serve at the start, for the current goal; 0 while driving


class Instance(NamedTuple):
    """One window to plan."""

    free: np.ndarray  # bool [H, W]; cells are ``row * W + column``
    agents: tuple[Agent, ...]  # everybody
    window: int  # timesteps planned ahead
    horizon: int  # timesteps driven; who is done stays until then
    # int [5, H, W], the cost of each move at each cell, 0 where it is not allowed; None for steps
    costs: np.ndarray | None = None

    def price(self, cell: int, there: int) -> int:
        """Look up what a move, or a wait, costs; 0 where it is not allowed."""
        if self.costs is None:
            return 1
        (row, column), (r, c) = (divmod(place, self.free.shape[1]) for place in (cell, there))
        return int(self.costs[((0, 0), *MOVES).index((r - row, c - column)), row, column])


class State(NamedTuple):
    """Where an agent stands: timestep, cell, goals reached (0 to 2), timesteps yet to serve."""

    time: int
    cell: int
    reached: int
    left: int


class TooManyError(Exception):
    """There are more choices than somebody was ready to try."""


def neighbours(free: np.ndarray, cell: int) -> list[int]:
    """List the free cells beside a cell."""
    height, width = free.shape
    row, column = divmod(cell, width)
    beside = [(row - 1, column), (row + 1, column), (row, column - 1), (row, column + 1)]
    return [r * width + c for r, c in beside if 0 <= r < height and 0 <= c < width and free[r, c]]


def distances(instance: Instance, goal: int) -> list[int]:
    """Count the steps, or costs, from every cell to a goal, until no way gets any shorter."""
    steps, queue = [FAR] * instance.free.size, [goal]
    steps[goal] = 0
    for cell in queue:
        for other in neighbours(instance.free, cell):
            price = instance.price(other, cell)
            if price > 0 and steps[cell] + price < steps[other]:
                steps[other] = steps[cell] + price
                queue.append(other)
    return steps


class Maze:
    """An instance with its moves and its distances looked up once."""

    def __init__(self, instance: Instance) -> None:
        """Look them up."""
        self.instance = instance
        cells = np.flatnonzero(instance.free).tolist()
        self.ways = {
            cell: [
                (there, price)
                for there in (cell, *neighbours(instance.free, cell))
                if (price := instance.price(cell, there)) > 0
            ]
            for cell in cells
        }
        goals = {goal for agent in instance.agents for goal in agent.goals}
        self.steps = {goal: distances(instance, goal) for goal in goals}

    def services_in_progress(self, but: int) -> list[Path]:
        """List where the others cannot be moved from, whatever their priority."""
        last = self.instance.window
        return [
            (agent.start,) * (min(agent.serving, last) + 1)
            for number, agent in enumerate(self.instance.agents)
            if agent.serving > 0 and number != but
        ]

    def first(self, agent: Agent) -> State:
        """Describe an agent at the start; what it serves there, it has reached."""
        return State(0, agent.start, int(agent.serving > 0), agent.serving)

    def is_last(self, state: State) -> bool:
        """Tell whether a path ends here: the window does, or nothing is left to do."""
        done = state.reached == 2 and state.left == 0
        return state.time == self.instance.window or (done and state.time >= self.instance.horizon)

    def rest(self, agent: Agent, state: State) -> int:
        """Count the steps still to drive after the window, through all goals not reached."""
        first, second = agent.goals
        if state.reached == 0:
            return self.steps[first][state.cell] + self.steps[second][first]
        return self.steps[second][state.cell] if state.reached == 1 else 0

    def after(self, agent: Agent, state: State, blocked: Blocked) -> list[tuple[int, State]]:
        """List what an agent can do next, with its cost."""
        time, cell, reached, left = state
        now, then = blocked[time], blocked[time + 1]
        ways = [(cell, 0)] if left > 0 else self.ways[cell]
        found = []
        for there, price in ways:
            if there in then or (there != cell and now.get(there) == cell):
                continue
            if left > 0:
                found.append((0, State(time + 1, there, reached, left - 1)))
            elif reached < 2 and there == agent.goals[reached]:
                stay = agent.services[reached]
                found.append((price, State(time + 1, there, reached + 1, stay)))
            else:
                found.append((price * (reached < 2), State(time + 1, there, reached, 0)))
        return found

    def blocked_by(self, number: int, others: list[Path]) -> Blocked:
        """Enter the paths of others and all services in progress."""
        blocked: Blocked = [{} for _ in range(self.instance.window + 1)]
        for path in [*self.services_in_progress(number), *others]:
            for time, cell in enumerate(path):
                # A service in progress is the beginning of its agent's path: the path tells more.
                blocked[time][cell] = path[time + 1] if time + 1 < len(path) else -1
        return blocked

    def costs(self, number: int, others: list[Path]) -> dict[State, float]:
        """Work out the least cost from every state that an agent can get into."""
        agent, blocked = self.instance.agents[number], self.blocked_by(number, others)
        best: dict[State, float] = {}

        def look(state: State) -> float:
            if state not in best:
                if self.is_last(state):
                    best[state] = self.rest(agent, state)
                else:
                    ways = self.after(agent, state, blocked)
                    best[state] = min((cost + look(way) for cost, way in ways), default=np.inf)
            return best[state]

        look(self.first(agent))
        return best

    def optimum(self, number: int, others: list[Path]) -> float:
        """Find the least cost of an agent's path among others; infinite where it has none."""
        return self.costs(number, others)[self.first(self.instance.agents[number])]

    def best_paths(self, number: int, others: list[Path]) -> Iterator[Path]:
        """List every cheapest path of an agent among others, each once."""
        agent, blocked = self.instance.agents[number], self.blocked_by(number, others)
        best = self.costs(number, others)

        def follow(state: State, path: Path) -> Iterator[Path]:
            if self.is_last(state):
                yield path
                return
            for cost, way in self.after(agent, state, blocked):
                if best[state] == cost + best[way]:
                    yield from follow(way, (*path, way.cell))

        first = self.first(agent)
        return follow(first, (agent.start,)) if best[first] < np.inf else iter(())

    def price(self, number: int, path: Path) -> int:
        """Drive an agent's path by the rules and price it; refuse what breaks one."""
        agent, clear = self.instance.agents[number], [{} for _ in range(self.instance.window + 1)]
        state, total = self.first(agent), 0
        assert path[0] == agent.start, f"agent {number} starts elsewhere"
        for there in path[1:]:
            assert not self.is_last(state), f"agent {number} goes on after its end"
            ways = [way for way in self.after(agent, state, clear) if way[1].cell == there]
            assert ways, f"agent {number} cannot go from {state} to {there}"
            total, state = total + ways[0][0], ways[0][1]
        assert self.is_last(state), f"agent {number} vanishes at {state}"
        return total + self.rest(agent, state)


def conflict(a: Path, b: Path) -> int:
    """Find the timestep of the first conflict of two paths; 0 where there is none."""
    for time in range(1, min(len(a), len(b))):
        swapped = a[time] == b[time - 1] and b[time] == a[time - 1]
        if a[time] == b[time] or swapped:
            return time
    return 0


def check_plan(maze: Maze, paths: list[Path]) -> list[int]:
    """Check a joint plan against every rule; returns the cost of each path."""
    for (i, a), (j, b) in itertools.combinations(enumerate(paths), 2):
        assert conflict(a, b) == 0, f"agents {i} and {j} meet at {conflict(a, b)}"
    return [maze.price(number, path) for number, path in enumerate(paths)]


def some_choice_works(maze: Maze, order: tuple[int, ...], most: int) -> bool:
    """Tell whether planning in this order can succeed, if every tie falls well."""
    return _works(maze, order, [], any, [most])


def every_choice_works(maze: Maze, order: tuple[int, ...], most: int) -> bool:
    """Tell whether planning in this order must succeed, however ties fall."""
    return _works(maze, order, [], all, [most])


def _works(maze: Maze, order: tuple[int, ...], paths: list[Path], judge, left: list[int]) -> bool:
    """Plan the rest of an order after `paths`; raises `TooManyError` after `left` searches."""
    if not order:
        return True
    left[0] -= 1
    if left[0] < 0:
        raise TooManyError
    number, rest = order[0], order[1:]
    if not rest:
        return maze.optimum(number, paths) < np.inf
    ways = maze.best_paths(number, paths)
    first = next(ways, None)
    if first is None:
        return False
    every = itertools.chain([first], ways)
    return judge(_works(maze, rest, [*paths, path], judge, left) for path in every)


def orders(maze: Maze) -> list[tuple[int, ...]]:
    """List all total priority orders, first the agent that all others avoid."""
    return list(itertools.permutations(range(len(maze.instance.agents))))


def random_costs(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Draw costs from few values, for ties, or from many; one move in ten is not allowed."""
    costs = rng.choice([rng.integers(1, 4, shape), rng.integers(1, 1000, shape)])
    return costs * (rng.random(shape) < np.where(np.arange(5) > 0, 0.9, 1)[:, None, None])


def random_instance(rng: np.random.Generator, count: int, has_costs: bool = False) -> Instance:
    """Draw a crowded instance; some agents serve at the start, and everybody reaches its goals."""
    while True:
        height, width = rng.integers(1, 6, 2)
        free = rng.random((height, width)) >= rng.choice([0.0, 0.2, 0.4])
        cells = np.flatnonzero(free)
        if cells.size:
            costs = random_costs(rng, (5, height, width)) if has_costs else None
            grid = Instance(free, (), 0, 0, costs)
            near = distances(grid, int(rng.choice(cells)))
            room = np.array([cell for cell in cells if near[cell] < FAR])
            # With one-way lanes, all cells of the room must reach all others.
            there = [distances(grid, goal) for goal in room]
            both_ways = all(steps[cell] < FAR for steps in there for cell in room)
            if count <= room.size <= max(count, 12) and both_ways:
                free = np.isin(np.arange(free.size), room).reshape(free.shape)
                break
    window = int(rng.integers(4, 7))
    agents = []
    for start in rng.permutation(room)[:count]:
        goals = rng.choice(room, 2)
        services = rng.choice([0, 0, 0, 1, 2, window + 1], 2)
        serving = 0
        if rng.random() < 0.15:
            goals[0] = start
            services[0] = max(1, services[0])
            serving = rng.integers(1, services[0] + 1)
        agents.append(
            Agent(
                int(start),
                (int(goals[0]), int(goals[1])),
                (int(services[0]), int(services[1])),
                int(serving),
            )
        )
    return Instance(free, tuple(agents), window, int(rng.integers(1, window + 1)), costs)
