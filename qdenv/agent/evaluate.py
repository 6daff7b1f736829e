"""Evaluate the maze agent: how often it reaches the goal of one maze, or of each of some."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qdenv.score import wilson_interval
from qdenv.simulate.maze.episode import (
    Episode,
    all_timesteps,
    run_episode,
    run_episodes,
)
from qdenv.simulate.maze.policy import Weights
from qdenv.simulate.maze.published import reference_episodes
from qdenv.simulate.maze.tables import prepare
from qdenv.simulate.maze.world import WALL
from qdenv.types import Array, InputError


class Success(NamedTuple):
    """How often the agent reached the goal of one maze."""

    rate: float
    low: float  # ends of the 95 % Wilson interval
    high: float
    runs: int
    mean_length: float  # actions, failures counted with the horizon
    shortest: int  # moves of the shortest path


def without_ring(layout: Array) -> np.ndarray:
    """Cut off the ring of walls where a maze has one (int8 [H, W] -> int8 [h, w], host side).

    All that lies outside a maze is wall, so nothing changes for the agent: not its start and goal,
    nor what it sees. What is counted in tiles or walls does change.
    """
    layout = np.asarray(layout)
    inside = layout[1:-1, 1:-1]
    ring = layout.size - inside.size
    walled = (layout == WALL).sum() - (inside == WALL).sum() == ring
    return inside if walled and inside.size else layout


def default_horizon(layout: Array) -> int:
    """Give the agent two actions per tile of the maze with its ring: 648 for 16x16.

    The ring counts once, whether the layout draws it or not.
    """
    rows, cols = without_ring(layout).shape
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
    horizon, key = horizon or default_horizon(layout), jax.random.key(seed)
    result = run_one(weights, layout, key, runs, horizon, reference_batching)
    if result.shortest == 0:
        raise InputError("this maze has no two empty tiles that touch: nothing to solve")
    return result


def run_one(
    weights: Weights,
    layout: Array,
    key: jax.Array,
    runs: int,
    horizon: int,
    reference_batching: bool = False,
) -> Success:
    """Sum up the episodes of one maze (host side); consumes the key.

    Args:
        weights: the agent.
        layout: int8 [H, W].
        key: of headings and actions.
        runs: episodes.
        horizon: actions per episode.
        reference_batching: run the published loop with its quirks.
    """
    play = _run_published if reference_batching else _run_alone
    episodes = play(weights, jnp.asarray(layout), key, runs, horizon)
    successes = int(episodes.success.sum())
    low, high = wilson_interval(successes, runs)
    mean, shortest = float(episodes.length.mean()), int(episodes.shortest[0])
    return Success(successes / runs, low, high, runs, mean, shortest)


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
            run_one(weights, layout, key, runs, horizon).rate
            for layout, key in zip(layouts, keys, strict=True)
        ]
    )
