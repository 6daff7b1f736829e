"""The maze agent at work: tables of one layout, one episode, its trace.

The 50 episodes of a layout are independent: each has its own first heading and its own actions.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qdenv.simulate.maze.policy import Memory, Weights, act, blank_memory, encode, recur
from qdenv.simulate.maze.world import (
    FORWARD,
    HEADINGS,
    TURN_LEFT,
    Course,
    Pose,
    canvas,
    image,
    longest_path,
    on_canvas,
    step,
    view,
)
from qdenv.types import Array

FEWEST = 12  # lanes below which dropping some saves nothing


class Tables(NamedTuple):
    """Everything an episode looks up; state ``position * 4 + heading`` indexes the rows."""

    course: Course
    ahead: Array  # int32 [4 H W], state after driving forward
    wins: Array  # bool [4 H W], driving forward reaches the goal
    gates: Array  # float32 [4 H W, 4 L], input of the LSTM's gates


class Episode(NamedTuple):
    """One run of the agent."""

    success: Array  # bool, the goal was reached within the horizon
    length: Array  # int32, actions taken; the horizon after a failure, 0 in an unsolvable level
    shortest: Array  # int32, moves of the shortest path; 0 in an unsolvable level


def prepare(weights: Weights, layout: Array) -> Tables:
    """Compute once per layout what all its episodes share.

    Within one maze the LSTM's input depends on cell and heading alone, so all 4 H W inputs are
    worked out here and only looked up later.

    Args:
        weights: the agent.
        layout: int8 [H, W].
    """
    course = longest_path(layout)
    width = layout.shape[1]
    kinds = canvas(layout, course.goal)
    states = jnp.arange(4 * layout.size, dtype=jnp.int32)
    cell, heading = states // 4, states % 4
    place = on_canvas(cell, width)
    pose, wins = jax.vmap(step, (None, 0, None))(kinds, Pose(place, heading), FORWARD)
    moved = (pose.position != place)[:, None]
    strides = jnp.asarray(HEADINGS @ np.array([width, 1]), jnp.int32)
    ahead = jnp.where(moved[:, 0], cell + strides[heading], cell) * 4 + heading
    views = image(jax.vmap(view, (None, 0, 0))(kinds, place, heading))
    gates = encode(weights, views, jax.nn.one_hot(heading, 4))
    return Tables(course, ahead, wins, gates)


def choose(logits: Array, uniform: Array) -> jax.Array:
    """Draw an action from a categorical by inverting its distribution function.

    Args:
        logits: float32 [..., actions].
        uniform: float32 [...] in [0, 1).
    """
    share = jnp.cumsum(jax.nn.softmax(logits), axis=-1)
    return (uniform[..., None] >= share[..., :-1]).sum(-1, dtype=jnp.int32)


class Running(NamedTuple):
    """An episode under way."""

    state: Array  # int32, position * 4 + heading
    memory: Memory
    length: Array  # int32, actions taken
    done: Array  # bool
    success: Array  # bool


Body = Callable[[Running, Array], Running]
Loop = Callable[[Body, Running, Array], Running]


def whole_horizon(
    body: Callable[[Running, Array], Running], first: Running, draws: Array
) -> Running:
    """Step to the horizon whatever happens: best for batches of mazes, where one always fails."""
    return jax.lax.scan(lambda now, draw: (body(now, draw), None), first, draws)[0]


def until_done(body: Body, first: Running, draws: Array) -> Running:
    """Stop when the episode is done: best for one maze at a time and for long horizons."""
    horizon = draws.shape[0]

    def advance(pair: tuple[Array, Running]) -> tuple[Array, Running]:
        t, now = pair
        return t + 1, body(now, draws[t])

    def under_way(pair: tuple[Array, Running]) -> Array:
        return (pair[0] < horizon) & ~pair[1].done

    return jax.lax.while_loop(under_way, advance, (jnp.int32(0), first))[1]


def run_episode(
    weights: Weights, tables: Tables, key: Array, horizon: int, loop: Loop = whole_horizon
) -> Episode:
    """Let the agent run from start to goal, sampling its actions.

    Both loops give the same episode for the same key, which is consumed.

    Args:
        weights: the agent.
        tables: from `prepare`.
        key: draws the first heading and all actions.
        horizon: actions after which the episode fails.
        loop: `whole_horizon` or `until_done`.
    """
    first, draws = _begin(weights, tables, key, horizon)
    last = loop(lambda now, draw: _act_once(weights, tables, now, draw), first, draws)
    return Episode(last.success, last.length, tables.course.length)


def run_episodes(weights: Weights, tables: Tables, keys: Array, horizon: int) -> Episode:
    """Run many episodes of one maze as `run_episode` does, dropping those that are over.

    Whenever half of the lanes are done, the others move together: a few long episodes then cost
    little. Widths are fixed at compile time, so this is traceable.

    Args:
        weights: the agent.
        tables: from `prepare`.
        keys: [S], consumed.
        horizon: actions after which an episode fails.

    Returns:
        `Episode` with leading axis [S].
    """
    now, draws = jax.vmap(lambda key: _begin(weights, tables, key, horizon))(keys)
    lane, t = jnp.arange(len(keys)), jnp.int32(0)
    success, length = now.success, now.length
    while lane.size:
        rest = lane.size // 2 if lane.size >= FEWEST else 0
        t, now = _until_few(weights, tables, draws, lane, rest, t, now)
        success = success.at[lane].set(now.success)
        length = length.at[lane].set(now.length)
        keep = jnp.argsort(now.done)[:rest]
        lane, now = jax.tree.map(lambda x, keep=keep: x[keep], (lane, now))
    return Episode(success, length, jnp.full(len(keys), tables.course.length))


def _until_few(
    weights: Weights, tables: Tables, draws: Array, lane: Array, rest: int, t: Array, now: Running
) -> tuple[Array, Running]:
    """Act in all lanes until at most `rest` of them are under way, or the horizon is reached."""

    def under_way(pair: tuple[Array, Running]) -> Array:
        return (pair[0] < draws.shape[1]) & ((~pair[1].done).sum() > rest)

    def advance(pair: tuple[Array, Running]) -> tuple[Array, Running]:
        t, now = pair
        act_all = jax.vmap(lambda now, draw: _act_once(weights, tables, now, draw))
        return t + 1, act_all(now, draws[lane, t])

    return jax.lax.while_loop(under_way, advance, (t, now))


def trace_episode(
    weights: Weights, tables: Tables, key: Array, horizon: int
) -> tuple[Episode, Pose]:
    """Run the episode that `run_episode` runs for this key and keep every pose.

    Returns:
        the episode, and `Pose` with leading axis [horizon + 1]; what follows the episode's end
        repeats its last pose (beside the goal, after a success).
    """
    first, draws = _begin(weights, tables, key, horizon)

    def body(now: Running, draw: Array) -> tuple[Running, Array]:
        later = _act_once(weights, tables, now, draw)
        return later, later.state

    last, states = jax.lax.scan(body, first, draws)
    states = jnp.concatenate([first.state[None], states])
    episode = Episode(last.success, last.length, tables.course.length)
    return episode, Pose(states // 4, states % 4)


def _begin(weights: Weights, tables: Tables, key: Array, horizon: int) -> tuple[Running, Array]:
    """Draw the first heading, and one number in [0, 1) for every action."""
    turn_key, draw_key = jax.random.split(key)
    heading = jax.random.randint(turn_key, (), 0, 4)
    first = Running(
        state=tables.course.start * 4 + heading,
        memory=blank_memory(weights),
        length=jnp.int32(0),
        done=tables.course.length < 1,
        success=jnp.bool_(False),
    )
    return first, jax.random.uniform(draw_key, (horizon,))


def _act_once(weights: Weights, tables: Tables, now: Running, draw: Array) -> Running:
    memory = recur(weights, tables.gates[now.state], now.memory)
    action = choose(act(weights, memory.hidden), draw)
    reached = (action == FORWARD) & tables.wins[now.state] & ~now.done
    turned = now.state // 4 * 4 + (now.state + jnp.where(action == TURN_LEFT, 3, 1)) % 4
    state = jnp.where(action < FORWARD, turned, now.state)
    state = jnp.where(action == FORWARD, tables.ahead[now.state], state)
    return Running(
        state=jnp.where(now.done, now.state, state),
        memory=memory,
        length=now.length + ~now.done,
        done=now.done | reached,
        success=now.success | reached,
    )
