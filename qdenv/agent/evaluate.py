"""Evaluate the maze agent: how often it reaches the goal of one maze, or of each of some."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qdenv.progress import Progress, silent
from qdenv.simulation.maze.episode import Episode, reference_episodes, run_episode, run_episodes
from qdenv.simulation.maze.policy import Weights, prepare
from qdenv.simulation.maze.world import WALL, longest_path
from qdenv.stats import standard_error, wilson_interval
from qdenv.types import Array, InputError

BAND = (0.8, 1.2)  # lengths of random mazes' paths, as shares of the given maze's


class Success(NamedTuple):
    """How often the agent reached the goal of one maze."""

    rate: float
    low: float  # ends of the 95 % Wilson interval
    high: float
    runs: int
    mean_length: float  # actions, failures counted with the horizon
    shortest: int  # moves of the shortest path


class Drawn(NamedTuple):
    """A random maze."""

    layout: np.ndarray  # int8 [H, W]
    start: int  # cell
    goal: int  # cell
    shortest: int  # moves from start to goal


class Comparison(NamedTuple):
    """Success on random mazes that resemble one maze."""

    walls: int  # of the given maze, inside its ring, and of every random one
    given: Drawn  # the given maze without its ring
    mazes: list[Drawn]  # the random mazes, without rings
    results: list[Success]  # of the agent on each of them
    rates: list[float]  # success rates of all random mazes
    mean: float  # of the rates
    standard_error: float  # of the mean, over mazes


def without_ring(layout: Array) -> np.ndarray:
    """Cut off the ring of walls where a maze has one (int8 [H, W] -> int8 [h, w], host side).

    All that lies outside a maze is wall, so nothing changes for the agent: not its start and goal,
    nor what it sees. What is counted in tiles or walls does change.
    """
    layout = np.asarray(layout)
    inside = layout[1:-1, 1:-1]
    walled = (layout == WALL).sum() - (inside == WALL).sum() == layout.size - inside.size
    return inside if walled and inside.size else layout


def default_horizon(layout: Array) -> int:
    """Return two actions per tile of the maze with its ring, drawn or not: 648 for 16 x 16."""
    rows, cols = without_ring(layout).shape
    return 2 * (rows + 2) * (cols + 2)


@partial(jax.jit, static_argnums=(3, 4))
def run_batch(
    weights: Weights, layouts: Array, key: jax.Array, episodes: int, horizon: int
) -> Episode:
    """Run every maze of a batch (int8 [B, H, W]) side by side; traceable, consumes the key.

    Returns `Episode` with leading axes [B, episodes].
    """

    def one(layout: Array, key: jax.Array) -> Episode:
        tables = prepare(weights, layout)
        keys = jax.random.split(key, episodes)
        return jax.vmap(lambda k: run_episode(weights, tables, k, horizon))(keys)

    return jax.vmap(one)(layouts, jax.random.split(key, layouts.shape[0]))


@partial(jax.jit, static_argnums=(3, 4))
def run_alone(
    weights: Weights, layout: Array, key: jax.Array, episodes: int, horizon: int
) -> Episode:
    """Run one maze, dropping episodes that are over; traceable, consumes the key."""
    keys = jax.random.split(key, episodes)
    return run_episodes(weights, prepare(weights, layout), keys, horizon)


_run_published = jax.jit(reference_episodes, static_argnums=(3, 4))
_longest_path = jax.jit(longest_path)


def _measure(
    play: Callable, weights: Weights, layout: Array, key: jax.Array, runs: int, horizon: int
) -> Success:
    """Sum up the episodes of one maze that `play` runs; consumes the key."""
    episodes = play(weights, jnp.asarray(layout), key, runs, horizon)
    successes = int(episodes.success.sum())
    low, high = wilson_interval(successes, runs)
    mean, shortest = float(episodes.length.mean()), int(episodes.shortest[0])
    return Success(successes / runs, low, high, runs, mean, shortest)


def evaluate_agent(
    weights: Weights,
    layout: Array,
    seed: int = 0,
    runs: int = 100,
    horizon: int | None = None,
    reference_batching: bool = False,
) -> Success:
    """Measure how often the agent reaches the goal of one maze of any size (host side).

    The maze (int8 [H, W]) may have a ring of walls. Each of the independent runs ends after
    `horizon` actions, `default_horizon` unless given. With `reference_batching` the published loop
    with its quirks runs instead (`reference_episodes`). Raises InputError if there are no runs, or
    no two empty tiles of the maze touch.
    """
    wilson_interval(0, runs)  # refuses a number of runs below one before any work is done
    horizon, key = horizon or default_horizon(layout), jax.random.key(seed)
    play = _run_published if reference_batching else run_alone
    result = _measure(play, weights, layout, key, runs, horizon)
    if result.shortest == 0:
        raise InputError("this maze has no two empty tiles that touch: nothing to solve")
    return result


def draw_mazes(
    seed: int,
    count: int,
    shape: tuple[int, int],
    walls: int,
    accept: Callable[[int], bool] = lambda length: length > 0,
    tries: int = 100_000,
    progress: Progress = silent,
) -> list[Drawn]:
    """Draw random mazes with exactly `walls` walls (host side).

    Only those are kept whose longest shortest path has an accepted length: by default every maze
    that can be solved. Raises InputError if `tries` mazes were not enough, or for more walls than
    tiles.
    """
    rows, cols = shape
    if not 0 <= walls <= rows * cols:
        raise InputError(f"{walls} walls do not fit on {rows} x {cols} tiles")
    rng = np.random.default_rng(seed)
    kept: list[Drawn] = []
    for _ in range(tries):
        if len(kept) == count:
            break
        layout = np.zeros(rows * cols, np.int8)
        layout[rng.permutation(rows * cols)[:walls]] = WALL
        layout = layout.reshape(shape)
        course = _longest_path(layout)
        if accept(int(course.length)):
            kept.append(Drawn(layout, *map(int, course)))
            progress("drawing random mazes", len(kept) / count, "")
    if len(kept) < count:
        few = f"{len(kept)} of {tries} random mazes have a path as long as required"
        raise InputError(f"{few}: draw fewer, or none")
    return kept


def compare_with_random(
    weights: Weights,
    layout: Array,
    mazes: int = 100,
    runs: int = 50,
    seed: int = 0,
    horizon: int | None = None,
    progress: Progress = silent,
) -> Comparison:
    """Measure the agent on random mazes of like size, walls and path length (host side).

    They resemble the maze `layout` (int8 [H, W], with or without a ring of walls): `BAND` holds
    the least and largest length of the longest shortest path, as shares of its own. Each of the
    episodes per maze ends after `horizon` actions, `default_horizon` unless given; the seed is that
    of walls, headings and actions. Raises InputError for fewer than two mazes, or if 100,000 tries
    give fewer such mazes.
    """
    if mazes < 2:
        raise InputError("a standard error needs at least two mazes")
    inside = without_ring(layout)
    horizon = horizon or default_horizon(layout)
    walls = int((inside == WALL).sum())
    given = Drawn(inside, *map(int, _longest_path(inside)))
    low, high = (share * given.shortest for share in BAND)
    drawn = draw_mazes(
        seed, mazes, inside.shape, walls, lambda length: low <= length <= high, progress=progress
    )
    results = []
    for maze, key in zip(drawn, jax.random.split(jax.random.key(seed), mazes), strict=True):
        results.append(_measure(run_alone, weights, maze.layout, key, runs, horizon))
        progress("solving random mazes", len(results) / mazes, "")
    rates = [result.rate for result in results]
    error = float(standard_error(rates))
    return Comparison(walls, given, drawn, results, rates, float(np.mean(rates)), error)
