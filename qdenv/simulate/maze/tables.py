"""What all episodes in one maze share, worked out once and looked up later."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from qdenv.lazy import jax, jnp
from qdenv.simulate.maze.policy import Weights, encode
from qdenv.simulate.maze.world import (
    FORWARD,
    HEADINGS,
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


class Tables(NamedTuple):
    """Everything an episode looks up; state ``position * 4 + heading`` indexes the rows."""

    layout: jax.Array  # int8 [H, W]
    course: Course  # start and goal
    ahead: jax.Array  # int32 [4 H W], state after driving forward
    wins: jax.Array  # bool [4 H W], driving forward reaches the goal
    gates: jax.Array  # float32 [4 H W, 4 L], input of the LSTM's gates


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
    return Tables(jnp.asarray(layout), course, ahead, wins, gates)
