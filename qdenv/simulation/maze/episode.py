"""The maze agent at work: one episode, many, and the trace of one.

Episodes are independent: each draws its own first heading and its own actions. The published
evaluation loop is `reference_episodes`, quirks included, to compare with its archives.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, TypeAlias

from qdenv.grid import pad
from qdenv.lazy import jax, jnp
from qdenv.simulation.maze.policy import Memory, Tables, Weights, act, blank_memory, encode, recur
from qdenv.simulation.maze.world import (
    FORWARD,
    REACH,
    TURN_LEFT,
    Pose,
    canvas,
    image,
    longest_path,
    step,
    view,
)
from qdenv.types import Array

_FEWEST = 12  # episodes below which dropping some saves nothing
FIRST_HEADINGS = (3, 0, 1, 2, 3, 1)  # the published loop's seed's; later ones are drawn


class Episode(NamedTuple):
    """One run of the agent."""

    success: jax.Array  # bool, the goal was reached within T timesteps
    length: jax.Array  # int32, actions taken; T after a failure, 0 in an unsolvable level
    shortest: jax.Array  # int32, moves of the shortest path; 0 in an unsolvable level
    # float32 [H, W], share of the actions taken on each cell; zeros where none was
    usage: jax.Array


def choose(logits: jax.Array, uniform: jax.Array) -> jax.Array:
    """Draw actions from logits (float32 [..., N]) and uniform numbers in [0, 1) (float32 [...])."""
    share = jnp.cumsum(jax.nn.softmax(logits), axis=-1)
    return (uniform[..., None] >= share[..., :-1]).sum(-1, dtype=jnp.int32)


class EpisodeState(NamedTuple):
    """An episode under way."""

    state: jax.Array  # int32, position * 4 + heading
    memory: Memory  # of the LSTM
    length: jax.Array  # int32, actions taken
    done: jax.Array  # bool, the goal is reached, or there is none to reach
    success: jax.Array  # bool
    actions: jax.Array  # int32 [H W], how many were taken on each cell


Body = Callable[[EpisodeState, jax.Array], EpisodeState]
Loop = Callable[[Body, EpisodeState, jax.Array], EpisodeState]


def all_timesteps(body: Body, first: EpisodeState, draws: jax.Array) -> EpisodeState:
    """Step to T whatever happens: best for batches of mazes, where one always fails."""
    return jax.lax.scan(lambda now, draw: (body(now, draw), None), first, draws)[0]


def until_done(body: Body, first: EpisodeState, draws: jax.Array) -> EpisodeState:
    """Stop when the episode is done: best for one maze at a time and for a large T."""
    return jax.lax.while_loop(
        lambda pair: (pair[0] < draws.shape[0]) & ~pair[1].done,
        lambda pair: (pair[0] + 1, body(pair[1], draws[pair[0]])),
        (jnp.int32(0), first),
    )[1]


def run_episode(
    weights: Weights, tables: Tables, key: jax.Array, timesteps: int, loop: Loop = all_timesteps
) -> Episode:
    """Let the agent run from start to goal, sampling its actions; consumes the key.

    The episode fails after `timesteps` actions. Both loops give the same episode for one key.
    """
    first, draws = _begin(weights, tables, key, timesteps)
    return _report(tables, loop(partial(_act_once, weights, tables), first, draws))


def _report(tables: Tables, last: EpisodeState) -> Episode:
    """Sum up an episode that has ended."""
    usage = (last.actions / jnp.maximum(last.length, 1)).reshape(tables.layout.shape)
    return Episode(last.success, last.length, tables.course.length, usage)


def run_episodes(weights: Weights, tables: Tables, keys: jax.Array, timesteps: int) -> Episode:
    """Run an episode of one maze for each of S keys, as `run_episode` does, dropping those over.

    Whenever half of the episodes are done, the others move together: a few long ones then cost
    little. Widths are fixed at compile time, so this is traceable. Consumes the keys.
    """
    now, draws = jax.vmap(lambda key: _begin(weights, tables, key, timesteps))(keys)
    place, t = jnp.arange(keys.shape[0]), jnp.int32(0)  # which episodes `now` holds
    last, act_all = now, jax.vmap(partial(_act_once, weights, tables))

    def act_until(rest: int, draws: jax.Array, first: Any) -> tuple[jax.Array, EpisodeState]:
        """Act in all episodes until at most `rest` of them are under way, or T is reached."""
        return jax.lax.while_loop(
            lambda pair: (pair[0] < timesteps) & ((~pair[1].done).sum() > rest),
            lambda pair: (pair[0] + 1, act_all(pair[1], draws[:, pair[0]])),
            first,
        )

    while place.size:
        rest = place.size // 2 if place.size >= _FEWEST else 0
        t, now = act_until(rest, draws[place], (t, now))
        last = jax.tree.map(lambda x, part, place=place: x.at[place].set(part), last, now)
        keep = jnp.argsort(now.done)[:rest]  # those under way come first
        place, now = jax.tree.map(lambda x, keep=keep: x[keep], (place, now))
    return jax.vmap(partial(_report, tables))(last)


def trace_episode(
    weights: Weights, tables: Tables, key: jax.Array, timesteps: int
) -> tuple[Episode, Pose]:
    """Run the episode that `run_episode` runs for this key and keep every pose [T + 1].

    After the episode's end its last pose is repeated (beside the goal, after a success).
    """
    first, draws = _begin(weights, tables, key, timesteps)

    def body(now: EpisodeState, draw: jax.Array) -> tuple[EpisodeState, jax.Array]:
        later = _act_once(weights, tables, now, draw)
        return later, later.state

    last, states = jax.lax.scan(body, first, draws)
    states = jnp.concatenate([first.state[None], states])
    return _report(tables, last), Pose(states // 4, states % 4)


def _begin(
    weights: Weights, tables: Tables, key: jax.Array, timesteps: int
) -> tuple[EpisodeState, jax.Array]:
    """Draw the first heading, and one number in [0, 1) for every action."""
    turn_key, draw_key = jax.random.split(key)
    heading = jax.random.randint(turn_key, (), 0, 4)
    first = EpisodeState(
        state=tables.course.start * 4 + heading,
        memory=blank_memory(weights),
        length=jnp.int32(0),
        done=tables.course.length < 1,
        success=jnp.bool_(False),
        actions=jnp.zeros(tables.layout.size, jnp.int32),
    )
    return first, jax.random.uniform(draw_key, (timesteps,))


def _act_once(weights: Weights, tables: Tables, now: EpisodeState, draw: jax.Array) -> EpisodeState:
    """Act by a number drawn from [0, 1); an episode that is done stays as it is."""
    memory = recur(weights, tables.gates[now.state], now.memory)
    action = choose(act(weights, memory.hidden), draw)
    reached = (action == FORWARD) & tables.wins[now.state] & ~now.done
    turned = now.state // 4 * 4 + (now.state + jnp.where(action == TURN_LEFT, 3, 1)) % 4
    state = jnp.where(action < FORWARD, turned, now.state)
    state = jnp.where(action == FORWARD, tables.ahead[now.state], state)
    return EpisodeState(
        state=jnp.where(now.done, now.state, state),
        memory=memory,
        length=now.length + ~now.done,
        done=now.done | reached,
        success=now.success | reached,
        actions=now.actions.at[now.state // 4].add(~now.done),
    )


# All E environments under way: random key; poses; memories [E, L]; actions of the episode of each
# and episodes that it has finished (int32 [E]). Then the episodes counted so far (int32), and their
# success (bool) and length (int32), each [episodes].
_Array: TypeAlias = "jax.Array"
_Batch: TypeAlias = tuple[_Array, Pose, Memory, _Array, _Array, _Array, _Array, _Array]


def reference_episodes(
    weights: Weights, layout: Array, key: jax.Array, episodes: int, timesteps: int, envs: int = 10
) -> Episode:
    """Run the published loop on one maze (int8 [H, W]); traceable, consumes the key.

    Two quirks: every environment of the batch sees the *union* of all environments' headings as its
    compass, and the first episodes to finish count, so short ones are over-represented. All share
    one random seed, hence the sequence of first headings.

    `envs` environments run side by side and restart by themselves; the first `episodes` to finish
    are counted, and returned in the order of finishing ([episodes], without a usage map).
    """
    course = longest_path(layout)
    kinds, start = canvas(layout, course.goal), pad(course.start, layout.shape[1], REACH)
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
    # The published loop draws no map of where the agent was.
    return Episode(success, length, shortest, jnp.zeros((episodes, *layout.shape)))
