"""The published evaluation loop of the maze, quirks included, to compare with its archives.

Two quirks: every lane of the batch is told the *union* of all lanes' headings as its compass, and
the first episodes to finish count, so short ones are over-represented. All lanes share one random
seed, hence the sequence of first headings. Not the default: see `maze.run_episode`.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from qdenv.simulate.maze.episode import Episode, choose
from qdenv.simulate.maze.policy import Memory, Weights, act, blank_memory, encode, recur
from qdenv.simulate.maze.world import Pose, canvas, image, longest_path, on_canvas, step, view
from qdenv.types import Array

FIRST_HEADINGS = (3, 0, 1, 2, 3, 1)  # the published seed's; later ones are drawn


class _Batch(NamedTuple):
    """All lanes under way, and the episodes counted so far."""

    key: Array
    pose: Pose  # leading axis [lanes]
    memory: Memory  # [lanes, L]
    elapsed: Array  # int32 [lanes]
    round: Array  # int32 [lanes], episodes this lane has finished
    counted: Array  # int32
    success: Array  # bool [episodes]
    length: Array  # int32 [episodes]


def reference_episodes(
    weights: Weights, layout: Array, key: Array, episodes: int, horizon: int, lanes: int = 10
) -> Episode:
    """Run the published loop on one maze; traceable.

    Args:
        weights: the agent.
        layout: int8 [H, W].
        key: consumed.
        episodes: how many of the first episodes to finish are counted.
        horizon: actions after which an episode fails.
        lanes: environments that run side by side and restart by themselves.

    Returns:
        `Episode` with leading axis [episodes], in the order of finishing.
    """
    course = longest_path(layout)
    kinds = canvas(layout, course.goal)
    start = on_canvas(course.start, layout.shape[1])
    turn_key, key = jax.random.split(key)
    headings = jax.random.randint(turn_key, (episodes + 1,), 0, 4)
    known = min(len(FIRST_HEADINGS), episodes + 1)
    headings = headings.at[:known].set(jnp.asarray(FIRST_HEADINGS[:known]))

    def body(now: _Batch) -> _Batch:
        key, draw_key = jax.random.split(now.key)
        compass = jax.nn.one_hot(now.pose.heading, 4).max(0)
        seen = jax.vmap(lambda pose: view(kinds, pose.position, pose.heading))(now.pose)
        gates = encode(weights, image(seen), jnp.broadcast_to(compass, (lanes, 4)))
        memory = recur(weights, gates, now.memory)
        action = choose(act(weights, memory.hidden), jax.random.uniform(draw_key, (lanes,)))
        pose, success = jax.vmap(lambda pose, action: step(kinds, pose, action))(now.pose, action)
        elapsed = now.elapsed + 1
        done = success | (elapsed >= horizon)
        # Finished lanes are counted in lane order; those beyond the last place are dropped.
        place = jnp.where(done, now.counted + jnp.cumsum(done) - 1, episodes)
        finished = now.round + done
        first = Pose(jnp.full((lanes,), start), headings[jnp.minimum(finished, episodes)])
        again = done[:, None]
        return _Batch(
            key=key,
            pose=jax.tree.map(lambda a, b: jnp.where(done, a, b), first, pose),
            memory=Memory(*(jnp.where(again, 0.0, part) for part in memory)),
            elapsed=jnp.where(done, 0, elapsed),
            round=finished,
            counted=now.counted + done.sum(),
            success=now.success.at[place].set(success, mode="drop"),
            length=now.length.at[place].set(elapsed, mode="drop"),
        )

    zeros = jnp.zeros(lanes, jnp.int32)
    first = _Batch(
        key=key,
        pose=Pose(jnp.full((lanes,), start), jnp.full((lanes,), headings[0])),
        memory=blank_memory(weights, (lanes,)),
        elapsed=zeros,
        round=zeros,
        counted=jnp.where(course.length > 0, 0, episodes),
        success=jnp.zeros(episodes, bool),
        length=jnp.zeros(episodes, jnp.int32),
    )
    last = jax.lax.while_loop(lambda now: now.counted < episodes, body, first)
    shortest = jnp.full((episodes,), course.length)
    return Episode(last.success, last.length, shortest)
