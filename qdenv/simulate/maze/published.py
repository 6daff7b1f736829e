"""The published evaluation loop of the maze, quirks included, to compare with its archives.

Two quirks: every environment of the batch sees the *union* of all environments' headings as its
compass, and the first episodes to finish count, so short ones are over-represented. All share one
random seed, hence the sequence of first headings. Not the default: that is `episode.run_episode`.
"""

from __future__ import annotations

from typing import NamedTuple

from qdenv.lazy import jax, jnp
from qdenv.simulate.maze.episode import Episode, choose
from qdenv.simulate.maze.policy import Memory, Weights, act, blank_memory, encode, recur
from qdenv.simulate.maze.world import Pose, canvas, image, longest_path, on_canvas, step, view
from qdenv.types import Array

FIRST_HEADINGS = (3, 0, 1, 2, 3, 1)  # the published seed's; later ones are drawn


class _Level(NamedTuple):
    """What all episodes share."""

    kinds: jax.Array  # int8 [H + 8, W + 8], the `canvas`
    start: jax.Array  # int32, flat index on the canvas
    headings: jax.Array  # int32 [episodes + 1], first heading of each environment's n-th episode


class _Batch(NamedTuple):
    """All environments under way, and the episodes counted so far; E environments."""

    key: jax.Array  # random key
    pose: Pose  # each [E]
    memory: Memory  # each [E, L]
    elapsed: jax.Array  # int32 [E], actions of the episode
    round: jax.Array  # int32 [E], episodes this environment has finished
    counted: jax.Array  # int32, episodes counted so far
    success: jax.Array  # bool [episodes]
    length: jax.Array  # int32 [episodes]


def reference_episodes(
    weights: Weights, layout: Array, key: jax.Array, episodes: int, timesteps: int, envs: int = 10
) -> Episode:
    """Run the published loop on one maze; traceable.

    Args:
        weights: the agent.
        layout: int8 [H, W].
        key: consumed.
        episodes: how many of the first episodes to finish are counted.
        timesteps: T, actions after which an episode fails.
        envs: environments that run side by side and restart by themselves.

    Returns:
        `Episode` with leading axis [episodes], in the order of finishing.
    """
    course = longest_path(layout)
    start = on_canvas(course.start, layout.shape[1])
    turn_key, key = jax.random.split(key)
    headings = jax.random.randint(turn_key, (episodes + 1,), 0, 4)
    known = min(len(FIRST_HEADINGS), episodes + 1)
    headings = headings.at[:known].set(jnp.asarray(FIRST_HEADINGS[:known]))
    level = _Level(canvas(layout, course.goal), start, headings)
    zeros = jnp.zeros(envs, jnp.int32)
    first = _Batch(
        key=key,
        pose=Pose(jnp.full((envs,), start), jnp.full((envs,), headings[0])),
        memory=blank_memory(weights, (envs,)),
        elapsed=zeros,
        round=zeros,
        counted=jnp.where(course.length > 0, 0, episodes),  # nobody runs where there is no goal
        success=jnp.zeros(episodes, bool),
        length=jnp.zeros(episodes, jnp.int32),
    )
    last = jax.lax.while_loop(
        lambda now: now.counted < episodes,
        lambda now: _act_all(weights, level, now, timesteps),
        first,
    )
    shortest = jnp.full((episodes,), course.length)
    nowhere = jnp.zeros((episodes, *layout.shape))  # the published loop draws no such map
    return Episode(last.success, last.length, shortest, nowhere)


def _act_all(weights: Weights, level: _Level, now: _Batch, timesteps: int) -> _Batch:
    """Act once in every environment."""
    key, draw_key = jax.random.split(now.key)
    compass = jax.nn.one_hot(now.pose.heading, 4).max(0)  # the first quirk: the union
    seen = jax.vmap(lambda pose: view(level.kinds, pose.position, pose.heading))(now.pose)
    gates = encode(weights, image(seen), jnp.broadcast_to(compass, (*now.elapsed.shape, 4)))
    memory = recur(weights, gates, now.memory)
    draws = jax.random.uniform(draw_key, now.elapsed.shape)
    action = choose(act(weights, memory.hidden), draws)
    pose, success = jax.vmap(lambda pose, action: step(level.kinds, pose, action))(now.pose, action)
    acted = now._replace(key=key, pose=pose, memory=memory, elapsed=now.elapsed + 1)
    return _count(level, acted, success, success | (acted.elapsed >= timesteps))


def _count(level: _Level, now: _Batch, success: jax.Array, done: jax.Array) -> _Batch:
    """Count the finished episodes (bool [E]) and begin the next ones in their place."""
    episodes = now.length.shape[0]
    # They count in the order of environments; those beyond the last place are dropped.
    place = jnp.where(done, now.counted + jnp.cumsum(done) - 1, episodes)
    finished = now.round + done
    heading = level.headings[jnp.minimum(finished, episodes)]
    first = Pose(jnp.full_like(now.pose.position, level.start), heading)
    return now._replace(
        pose=jax.tree.map(lambda a, b: jnp.where(done, a, b), first, now.pose),
        memory=Memory(*(jnp.where(done[:, None], 0.0, part) for part in now.memory)),
        elapsed=jnp.where(done, 0, now.elapsed),
        round=finished,
        counted=now.counted + done.sum(),
        success=now.success.at[place].set(success, mode="drop"),
        length=now.length.at[place].set(now.elapsed, mode="drop"),
    )
