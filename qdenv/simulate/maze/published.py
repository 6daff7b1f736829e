"""The published evaluation loop of the maze, quirks included, to compare with its archives.

Two quirks: every environment of the batch sees the *union* of all environments' headings as its
compass, and the first episodes to finish count, so short ones are over-represented. All share one
random seed, hence the sequence of first headings. Not the default: that is `episode.run_episode`.
"""

from __future__ import annotations

from typing import TypeAlias

from qdenv.lazy import jax, jnp
from qdenv.simulate.maze.episode import Episode, choose
from qdenv.simulate.maze.policy import Memory, Weights, act, blank_memory, encode, recur
from qdenv.simulate.maze.world import Pose, canvas, image, longest_path, on_canvas, step, view
from qdenv.types import Array

FIRST_HEADINGS = (3, 0, 1, 2, 3, 1)  # the published seed's; later ones are drawn


# All E environments under way: random key; poses; memories [E, L]; actions of the episode of each
# and episodes that it has finished (int32 [E]). Then the episodes counted so far (int32), and their
# success (bool) and length (int32), each [episodes].
_Array: TypeAlias = "jax.Array"
_Batch: TypeAlias = tuple[_Array, Pose, Memory, _Array, _Array, _Array, _Array, _Array]


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
    first = (
        key,
        Pose(jnp.full((envs,), start), jnp.full((envs,), headings[0])),
        blank_memory(weights, (envs,)),
        zeros,
        zeros,
        jnp.where(course.length > 0, 0, episodes),  # nothing runs where there is no goal
        jnp.zeros(episodes, bool),
        jnp.zeros(episodes, jnp.int32),
    )

    def act_all(now: _Batch) -> _Batch:
        key, before, memory, elapsed, rounds, counted, successes, lengths = now
        key, draw_key = jax.random.split(key)
        compass = jax.nn.one_hot(before.heading, 4).max(0)  # the first quirk: the union
        seen = jax.vmap(lambda pose: view(kinds, pose.position, pose.heading))(before)
        gates = encode(weights, image(seen), jnp.broadcast_to(compass, (envs, 4)))
        memory = recur(weights, gates, memory)
        action = choose(act(weights, memory.hidden), jax.random.uniform(draw_key, (envs,)))
        pose, success = jax.vmap(lambda pose, action: step(kinds, pose, action))(before, action)
        elapsed = elapsed + 1
        done = success | (elapsed >= timesteps)
        # Episodes count in the order of environments; those beyond the last place are dropped.
        place = jnp.where(done, counted + jnp.cumsum(done) - 1, episodes)
        finished = rounds + done
        heading = headings[jnp.minimum(finished, episodes)]
        restart = Pose(jnp.full_like(pose.position, start), heading)
        return (
            key,
            jax.tree.map(lambda a, b: jnp.where(done, a, b), restart, pose),
            Memory(*(jnp.where(done[:, None], 0.0, part) for part in memory)),
            jnp.where(done, 0, elapsed),
            finished,
            counted + done.sum(),
            successes.at[place].set(success, mode="drop"),
            lengths.at[place].set(elapsed, mode="drop"),
        )

    *_, success, length = jax.lax.while_loop(lambda now: now[5] < episodes, act_all, first)
    shortest = jnp.full((episodes,), course.length)
    nowhere = jnp.zeros((episodes, *layout.shape))  # the published loop draws no such map
    return Episode(success, length, shortest, nowhere)
