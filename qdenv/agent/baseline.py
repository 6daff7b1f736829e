"""Random mazes, the baseline of grown ones: as many walls, a path of like length (section E.3)."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np

from qdenv.agent.evaluate import Success, default_horizon, evaluate_agent, run_one, without_ring
from qdenv.simulate.maze.policy import Weights
from qdenv.simulate.maze.world import WALL, longest_path
from qdenv.types import Array, InputError

BAND = (0.8, 1.2)  # lengths of random mazes' paths, as shares of the given maze's

# Told what is being done and which share of it is done, as `commands.waiting` is.
Progress = Callable[[str, float], None]

_longest_path = jax.jit(longest_path)


def random_layout(rng: np.random.Generator, rows: int, cols: int, walls: int) -> np.ndarray:
    """Put exactly `walls` walls on random tiles (int8 [rows, cols])."""
    layout = np.zeros(rows * cols, np.int8)
    layout[rng.permutation(rows * cols)[:walls]] = 1
    return layout.reshape(rows, cols)


class Drawn(NamedTuple):
    """A random maze."""

    layout: np.ndarray  # int8 [H, W]
    start: int  # cell
    goal: int  # cell
    shortest: int  # moves from start to goal


def draw_mazes(
    seed: int,
    count: int,
    shape: tuple[int, int],
    walls: int,
    accept: Callable[[int], bool] = lambda length: length > 0,
    tries: int = 100_000,
    progress: Progress = lambda doing, share: None,
) -> list[Drawn]:
    """Draw random mazes whose longest shortest path is accepted (host side).

    Args:
        seed: of the walls.
        count: mazes wanted.
        shape: rows and columns.
        walls: walls of each.
        accept: length of the longest shortest path -> keep it; by default every solvable maze.
        tries: mazes drawn before giving up.
        progress: told how far it is.

    Raises:
        InputError: `tries` mazes were not enough, or more walls than tiles.
    """
    rows, cols = shape
    if not 0 <= walls <= rows * cols:
        raise InputError(f"{walls} walls do not fit on {rows} x {cols} tiles")
    rng = np.random.default_rng(seed)
    kept: list[Drawn] = []
    for _ in range(tries):
        if len(kept) == count:
            break
        layout = random_layout(rng, rows, cols, walls)
        course = _longest_path(layout)
        if accept(int(course.length)):
            kept.append(Drawn(layout, *map(int, course)))
            progress("drawing random mazes", len(kept) / count)
    if len(kept) < count:
        raise InputError(
            f"only {len(kept)} of {tries} random mazes have such a path: widen the bounds"
        )
    return kept


def random_mazes(
    seed: int,
    count: int,
    rows: int,
    cols: int,
    walls: int,
    accept: Callable[[int], bool] = lambda length: length > 0,
    tries: int = 100_000,
) -> np.ndarray:
    """Draw random mazes as `draw_mazes` does -> int8 [count, rows, cols].

    Raises:
        InputError: `tries` mazes were not enough, or more walls than tiles.
    """
    drawn = draw_mazes(seed, count, (rows, cols), walls, accept, tries)
    return np.array([maze.layout for maze in drawn], np.int8).reshape(count, rows, cols)


class Comparison(NamedTuple):
    """Success on random mazes that resemble one maze."""

    walls: int  # of the given maze, inside its ring, and of every random one
    given: Drawn  # the given maze without its ring
    mazes: list[Drawn]  # the random mazes, without rings
    horizon: int  # actions per episode
    results: list[Success]  # of the agent on each of them

    @property
    def rates(self) -> list[float]:
        """Success rates of all mazes."""
        return [result.rate for result in self.results]

    @property
    def mean(self) -> float:
        """Mean success rate."""
        return float(np.mean(self.rates))

    @property
    def standard_error(self) -> float:
        """Standard error of the mean, over mazes."""
        return float(np.std(self.rates, ddof=1) / len(self.rates) ** 0.5)


def compare_with_random(
    weights: Weights,
    layout: Array,
    mazes: int = 100,
    runs: int = 50,
    seed: int = 0,
    horizon: int | None = None,
    band: tuple[float, float] = BAND,
    progress: Progress = lambda doing, share: None,
) -> Comparison:
    """Measure the agent on random mazes of like size, walls and path length (host side).

    Args:
        weights: the agent.
        layout: int8 [H, W], the maze to compare with, with or without a ring of walls.
        mazes: random mazes.
        runs: independent episodes per maze.
        seed: of walls, headings and actions.
        horizon: actions per episode; twice the tiles of the ringed maze by default.
        band: least and largest length of the longest shortest path, as shares of the given maze's.
        progress: told how far it is.

    Raises:
        InputError: fewer than two mazes, or no such mazes within 100,000 tries.
    """
    if mazes < 2:
        raise InputError("a standard error needs at least two mazes")
    inside = without_ring(layout)
    horizon = horizon or default_horizon(inside)
    walls = int((inside == WALL).sum())
    given = Drawn(inside, *map(int, _longest_path(inside)))
    low, high = (share * given.shortest for share in band)
    drawn = draw_mazes(
        seed, mazes, inside.shape, walls, lambda length: low <= length <= high, progress=progress
    )
    results = []
    for maze, key in zip(drawn, jax.random.split(jax.random.key(seed), mazes), strict=True):
        results.append(run_one(weights, maze.layout, key, runs, horizon))
        progress("solving random mazes", len(results) / mazes)
    return Comparison(walls, given, drawn, horizon, results)


class MazeSuccess(NamedTuple):
    """The agent on a maze and on random ones like it, a row of the paper's comparison."""

    rows: int  # of the maze, without its ring
    cols: int  # of the maze, without its ring
    own: Success  # success on the maze
    others: Comparison  # success on random mazes


def maze_success(
    weights: Weights,
    layout: Array,
    runs: int = 100,
    mazes: int = 100,
    random_runs: int = 50,
    seed: int = 0,
    progress: Progress = lambda doing, share: None,
) -> MazeSuccess:
    """Measure the agent on a maze and on random mazes like it (host side).

    Args:
        weights: the agent.
        layout: int8 [H, W], with or without a ring of walls.
        runs: independent episodes on the maze.
        mazes: random mazes.
        random_runs: independent episodes on each of them.
        seed: of walls, headings and actions.
        progress: told how far it is.

    Raises:
        InputError: fewer than two random mazes, none to be found, or nothing to solve.
    """
    inside = without_ring(layout)
    own = evaluate_agent(weights, inside, seed, runs)
    others = compare_with_random(weights, inside, mazes, random_runs, seed, progress=progress)
    rows, cols = inside.shape
    return MazeSuccess(rows, cols, own, others)
