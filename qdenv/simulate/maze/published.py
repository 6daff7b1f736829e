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
    """Run the published loop on one maze (int8 [H, W]); traceable, consumes the key.

    `envs` environments run side by side and restart by themselves; the first `episodes` to finish
    are counted, and returned in the order of finishing ([episodes], without a usage map).
    """
    course = longest_path(layout)
    kinds, start = canvas(layout, course.goal), on_canvas(course.start, layout.shape[1])
    turn_key, key = jax.random.split(key)
    # First heading of each environment's n-th episode.
    headings = jax.random.randint(turn_key, (episodes + 1,), 0, 4)
    known = min(len(FIRST_HEADINGS), episodes + 1)
    headings = headings.at[:known].set(jnp.asarray(FIRST_HEADINGS[:known]))
    zeros = jnp.zeros(envs, jnp.int32)
    first = _Batch(
        key=key,
        pose=Pose(jnp.full((envs,), start), jnp.full((envs,), headings[0])),
        memory=blank_memory(weights, (envs,)),
        elapsed=zeros,
        round=zeros,
        counted=jnp.where(course.length > 0, 0, episodes),  # nothing runs where there is no goal
        success=jnp.zeros(episodes, bool),
        length=jnp.zeros(episodes, jnp.int32),
    )

    def act_all(now: _Batch) -> _Batch:
        key, draw_key = jax.random.split(now.key)
        compass = jax.nn.one_hot(now.pose.heading, 4).max(0)  # the first quirk: the union
        seen = jax.vmap(lambda pose: view(kinds, pose.position, pose.heading))(now.pose)
        gates = encode(weights, image(seen), jnp.broadcast_to(compass, (envs, 4)))
        memory = recur(weights, gates, now.memory)
        action = choose(act(weights, memory.hidden), jax.random.uniform(draw_key, (envs,)))
        pose, success = jax.vmap(lambda pose, action: step(kinds, pose, action))(now.pose, action)
        elapsed = now.elapsed + 1
        done = success | (elapsed >= timesteps)
        # Episodes count in the order of environments; those beyond the last place are dropped.
        place = jnp.where(done, now.counted + jnp.cumsum(done) - 1, episodes)
        finished = now.round + done
        heading = headings[jnp.minimum(finished, episodes)]
        restart = Pose(jnp.full_like(pose.position, start), heading)
        return _Batch(
            key=key,
            pose=jax.tree.map(lambda a, b: jnp.where(done, a, b), restart, pose),
            memory=Memory(*(jnp.where(done[:, None], 0.0, part) for part in memory)),
            elapsed=jnp.where(done, 0, elapsed),
            round=finished,
            counted=now.counted + done.sum(),
            success=now.success.at[place].set(success, mode="drop"),
            length=now.length.at[place].set(elapsed, mode="drop"),
        )

    last = jax.lax.while_loop(lambda now: now.counted < episodes, act_all, first)
    shortest = jnp.full((episodes,), course.length)
    nowhere = jnp.zeros((episodes, *layout.shape))  # the published loop draws no such map
    return Episode(last.success, last.length, shortest, nowhere)
