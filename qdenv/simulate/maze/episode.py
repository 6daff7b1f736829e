"""The maze agent at work: one episode, many, and the trace of one.

Episodes are independent: each draws its own first heading and its own actions.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

from qdenv.lazy import jax, jnp
from qdenv.simulate.maze.policy import Memory, Tables, Weights, act, blank_memory, recur
from qdenv.simulate.maze.world import FORWARD, TURN_LEFT, Pose

_FEWEST = 12  # episodes below which dropping some saves nothing


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
    last = loop(partial(_act_once, weights, tables), first, draws)
    return _report(tables, last)


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
    last = now
    while place.size:
        rest = place.size // 2 if place.size >= _FEWEST else 0
        t, now = _until_few(weights, tables, draws[place], rest, (t, now))
        last = jax.tree.map(lambda x, part, place=place: x.at[place].set(part), last, now)
        keep = jnp.argsort(now.done)[:rest]  # those under way come first
        place, now = jax.tree.map(lambda x, keep=keep: x[keep], (place, now))
    return jax.vmap(partial(_report, tables))(last)


def _until_few(
    weights: Weights,
    tables: Tables,
    draws: jax.Array,
    rest: int,
    first: tuple[jax.Array, EpisodeState],
) -> tuple[jax.Array, EpisodeState]:
    """Act in all episodes until at most `rest` of them are under way, or T is reached."""
    act_all = jax.vmap(partial(_act_once, weights, tables))
    return jax.lax.while_loop(
        lambda pair: (pair[0] < draws.shape[1]) & ((~pair[1].done).sum() > rest),
        lambda pair: (pair[0] + 1, act_all(pair[1], draws[:, pair[0]])),
        first,
    )


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
