"""Evaluate the maze agent: success over many runs, random mazes of a given path length."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qdenv.score.traffic import wilson_interval
from qdenv.simulate.maze.episode import (
    Episode,
    all_timesteps,
    run_episode,
    run_episodes,
)
from qdenv.simulate.maze.policy import Weights
from qdenv.simulate.maze.published import reference_episodes
from qdenv.simulate.maze.tables import prepare
from qdenv.simulate.maze.world import WALL, longest_path
from qdenv.types import Array, InputError


class Success(NamedTuple):
    """How often the agent reached the goal of one maze."""

    rate: float
    low: float  # ends of the 95 % Wilson interval
    high: float
    runs: int
    mean_length: float  # actions, failures counted with the horizon
    shortest: int  # moves of the shortest path


def default_horizon(layout: Array) -> int:
    """Give the agent two actions per tile of the maze with its ring: 648 for 16x16."""
    rows, cols = layout.shape
    return 2 * (rows + 2) * (cols + 2)


def run_batch(
    weights: Weights, layouts: Array, key: jax.Array, episodes: int, horizon: int
) -> Episode:
    """Run every maze of a batch side by side; traceable.

    Args:
        weights: the agent.
        layouts: int8 [B, H, W].
        key: consumed.
        episodes: runs per maze.
        horizon: actions after which a run fails.

    Returns:
        `Episode` with leading axes [B, episodes].
    """

    def one(layout: Array, key: jax.Array) -> Episode:
        tables = prepare(weights, layout)
        keys = jax.random.split(key, episodes)
        return jax.vmap(lambda k: run_episode(weights, tables, k, horizon, all_timesteps))(keys)

    return jax.vmap(one)(layouts, jax.random.split(key, layouts.shape[0]))


def run_alone(
    weights: Weights, layout: Array, key: jax.Array, episodes: int, horizon: int
) -> Episode:
    """Run one maze, dropping episodes that are over; traceable, arguments of `run_batch`."""
    keys = jax.random.split(key, episodes)
    return run_episodes(weights, prepare(weights, layout), keys, horizon)


_longest_path = jax.jit(longest_path)
_run_alone = jax.jit(run_alone, static_argnums=(3, 4))
_run_published = jax.jit(reference_episodes, static_argnums=(3, 4))


def evaluate_agent(
    weights: Weights,
    layout: Array,
    seed: int = 0,
    runs: int = 100,
    horizon: int | None = None,
    reference_batching: bool = False,
) -> Success:
    """Measure how often the agent reaches the goal of one maze of any size (host side).

    Args:
        weights: the agent.
        layout: int8 [H, W], with or without a ring of walls.
        seed: of headings and actions.
        runs: independent episodes.
        horizon: actions per episode; twice the tiles of the ringed maze by default.
        reference_batching: run the published loop with its quirks (`qdenv.simulate.maze.published`)
            instead of independent episodes.

    Raises:
        InputError: no runs, or a maze in which no two empty tiles touch.
    """
    wilson_interval(0, runs)
    play = _run_published if reference_batching else _run_alone
    episodes = play(
        weights, jnp.asarray(layout), jax.random.key(seed), runs, horizon or default_horizon(layout)
    )
    shortest = int(episodes.shortest[0])
    if shortest == 0:
        raise InputError("this maze has no two empty tiles that touch: nothing to solve")
    successes = int(episodes.success.sum())
    low, high = wilson_interval(successes, runs)
    mean = float(episodes.length.mean())
    return Success(successes / runs, low, high, runs, mean, shortest)


def random_layout(rng: np.random.Generator, rows: int, cols: int, walls: int) -> np.ndarray:
    """Put exactly `walls` walls on random tiles (int8 [rows, cols])."""
    layout = np.zeros(rows * cols, np.int8)
    layout[rng.permutation(rows * cols)[:walls]] = 1
    return layout.reshape(rows, cols)


def random_mazes(
    seed: int,
    count: int,
    rows: int,
    cols: int,
    walls: int,
    accept: Callable[[int], bool] = lambda length: length > 0,
    tries: int = 100_000,
) -> np.ndarray:
    """Draw random mazes whose longest shortest path is accepted (host side).

    Args:
        seed: of the walls.
        count: mazes wanted, B.
        rows: H.
        cols: W.
        walls: walls of each.
        accept: length of the longest shortest path -> keep it; by default every solvable maze.
        tries: mazes drawn before giving up.

    Returns:
        int8 [B, H, W].

    Raises:
        InputError: `tries` mazes were not enough, or more walls than tiles.
    """
    if not 0 <= walls <= rows * cols:
        raise InputError(f"{walls} walls do not fit on {rows} x {cols} tiles")
    rng = np.random.default_rng(seed)
    kept: list[np.ndarray] = []
    for _ in range(tries):
        if len(kept) == count:
            break
        layout = random_layout(rng, rows, cols, walls)
        if accept(int(_longest_path(layout).length)):
            kept.append(layout)
    if len(kept) < count:
        raise InputError(
            f"only {len(kept)} of {tries} random mazes have such a path: widen the bounds"
        )
    return np.array(kept, np.int8).reshape(count, rows, cols)


def success_rates(
    weights: Weights, layouts: Array, seed: int = 0, runs: int = 50, horizon: int | None = None
) -> np.ndarray:
    """Measure the success rate on each of some mazes of one size (host side).

    Args:
        weights: the agent.
        layouts: int8 [B, H, W].
        seed: of headings and actions.
        runs: independent episodes per maze.
        horizon: actions per episode; twice the tiles of the ringed maze by default.

    Returns:
        float [B].
    """
    horizon = horizon or default_horizon(layouts[0])
    keys = jax.random.split(jax.random.key(seed), len(layouts))
    return np.array(
        [
            _run_alone(weights, jnp.asarray(layout), key, runs, horizon).success.mean()
            for layout, key in zip(layouts, keys, strict=True)
        ]
    )


class Comparison(NamedTuple):
    """Success on random mazes that resemble one maze (section E.3 of the paper)."""

    mean: float
    standard_error: float  # over mazes
    mazes: int
    walls: int
    shortest: int  # of the maze that was given
    rates: list[float]


def compare_with_random(
    weights: Weights,
    layout: Array,
    low: float = 0.8,
    high: float = 1.2,
    mazes: int = 100,
    runs: int = 50,
    seed: int = 0,
) -> Comparison:
    """Measure the agent on random mazes of like size, walls and path length (host side).

    Args:
        weights: the agent.
        layout: int8 [H, W], the maze to compare with.
        low: least length of the longest shortest path, as a share of the given maze's.
        high: largest length, as a share.
        mazes: random mazes.
        runs: independent episodes per maze.
        seed: of walls, headings and actions.

    Raises:
        InputError: fewer than two mazes, or no such mazes within 100,000 tries.
    """
    if mazes < 2:
        raise InputError("a standard error needs at least two mazes")
    walls = int((np.asarray(layout) == WALL).sum())
    shortest = int(_longest_path(jnp.asarray(layout)).length)

    def accept(length: int) -> bool:
        return low * shortest <= length <= high * shortest

    rows, cols = layout.shape
    drawn = random_mazes(seed, mazes, rows, cols, walls, accept)
    rates = success_rates(weights, drawn, seed, runs)
    error = float(rates.std(ddof=1) / mazes**0.5)
    return Comparison(float(rates.mean()), error, mazes, walls, shortest, rates.tolist())
