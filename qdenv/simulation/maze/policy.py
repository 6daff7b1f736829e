"""The maze agent's network: convolution, compass, LSTM, actor and critic; load and save.

The architecture is the published one (433,953 parameters with 256 units and 7 actions, two of whose
bias vectors are one here), with the number of units and of actions read off the weights.
"""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import NamedTuple

import numpy as np

from qdenv.grid import pad
from qdenv.io.arrays import Column, read_arrays
from qdenv.lazy import jax, jnp
from qdenv.simulation.maze import world
from qdenv.types import Array, InputError

VIEW, WINDOW, CHANNELS, FILTERS, COMPASS, HEAD = 5, 3, 3, 16, 5, 32
PATCHES = VIEW - WINDOW + 1
_FEATURES = FILTERS * PATCHES * PATCHES + COMPASS
SHIPPED_AGENT = Path(str(resources.files("qdenv.simulation.maze") / "agent.npz"))


class Weights(NamedTuple):
    """The agent, float32; L LSTM units, N actions.

    Gates lie in the order input, forget, cell, output, as in PyTorch's LSTM
    (https://pytorch.org/docs/stable/generated/torch.nn.LSTM.html).
    """

    kernel: Array  # [3, 3, 3, 16]: x, y, channel, filter
    kernel_bias: Array  # [16]
    compass: Array  # [4, 5]
    compass_bias: Array  # [5]
    gates_in: Array  # [149, 4 L], rows: 16 filters x 3 x 3, then the compass
    gates_back: Array  # [L, 4 L]
    gates_bias: Array  # [4 L]
    actor: Array  # [L, 32]
    actor_bias: Array  # [32]
    logits: Array  # [32, N]
    logits_bias: Array  # [N]
    critic: Array  # [L, 32]
    critic_bias: Array  # [32]
    value: Array  # [32, 1]
    value_bias: Array  # [1]


class Memory(NamedTuple):
    """State of the LSTM."""

    hidden: Array  # float32 [..., L]
    cell: Array  # float32 [..., L]


def blank_memory(weights: Weights, batch: tuple[int, ...] = ()) -> Memory:
    """Make the memory with which an episode starts, zeros [*batch, L]."""
    zeros = jnp.zeros((*batch, weights.gates_back.shape[0]), jnp.float32)
    return Memory(zeros, zeros)


def _affine(inputs: Array, kernel: Array, bias: Array) -> jax.Array:
    """Multiply by `kernel` [m, n] and add `bias` [n] (float32 [..., m] -> [..., n])."""
    return jnp.matmul(inputs, kernel) + jnp.expand_dims(bias, tuple(range(inputs.ndim - 1)))


def encode(weights: Weights, image: Array, compass: Array) -> jax.Array:
    """Turn observations into the input of the LSTM's gates (float32 [..., 4 L]).

    The image is float32 [..., 5, 5, 3], indexed [x, y, channel], the compass a one-hot heading.
    """
    # The valid convolution as one matrix [75, 144]: rows x, y, channel, columns filter, x, y.
    dense = jnp.zeros((VIEW, VIEW, CHANNELS, FILTERS, PATCHES, PATCHES), weights.kernel.dtype)
    for x in range(PATCHES):
        for y in range(PATCHES):
            dense = dense.at[x : x + WINDOW, y : y + WINDOW, :, :, x, y].set(weights.kernel)
    dense = dense.reshape(VIEW * VIEW * CHANNELS, FILTERS * PATCHES * PATCHES)
    flat = image.reshape(*image.shape[:-3], -1)
    seen = _affine(flat, dense, jnp.repeat(weights.kernel_bias, PATCHES**2))
    facing = _affine(compass, weights.compass, weights.compass_bias)
    split = seen.shape[-1]
    gates = jax.nn.relu(seen) @ weights.gates_in[:split] + facing @ weights.gates_in[split:]
    return gates + jnp.expand_dims(weights.gates_bias, tuple(range(gates.ndim - 1)))


def recur(weights: Weights, gates: Array, memory: Memory) -> Memory:
    """Advance the LSTM by one step (gates float32 [..., 4 L] from `encode`)."""
    i, f, g, o = jnp.split(gates + memory.hidden @ weights.gates_back, 4, axis=-1)
    cell = jax.nn.sigmoid(f) * memory.cell + jax.nn.sigmoid(i) * jnp.tanh(g)
    return Memory(jax.nn.sigmoid(o) * jnp.tanh(cell), cell)


def act(weights: Weights, hidden: Array) -> jax.Array:
    """Score the actions (float32 [..., L] -> logits float32 [..., N])."""
    inner = jnp.tanh(_affine(hidden, weights.actor, weights.actor_bias))
    return _affine(inner, weights.logits, weights.logits_bias)


def estimate_value(weights: Weights, hidden: Array) -> jax.Array:
    """Estimate the return (float32 [..., L] -> float32 [...])."""
    inner = jnp.tanh(_affine(hidden, weights.critic, weights.critic_bias))
    return _affine(inner, weights.value, weights.value_bias)[..., 0]


def shapes(units: int, actions: int) -> dict[str, tuple[int, ...]]:
    """List the shape of every weight, by its name and in the order of `Weights`."""
    return {
        "kernel": (WINDOW, WINDOW, CHANNELS, FILTERS),
        "kernel_bias": (FILTERS,),
        "compass": (4, COMPASS),
        "compass_bias": (COMPASS,),
        "gates_in": (_FEATURES, 4 * units),
        "gates_back": (units, 4 * units),
        "gates_bias": (4 * units,),
        "actor": (units, HEAD),
        "actor_bias": (HEAD,),
        "logits": (HEAD, actions),
        "logits_bias": (actions,),
        "critic": (units, HEAD),
        "critic_bias": (HEAD,),
        "value": (HEAD, 1),
        "value_bias": (1,),
    }


def draw_weights(key: jax.Array, units: int, actions: int) -> Weights:
    """Draw an untrained agent: orthogonal matrices, small logits; consumes the key."""
    sizes = shapes(units, actions)
    # An actor that starts indifferent explores; the other gains keep the signals' variance.
    gains = {"kernel": 2**0.5, "gates_in": 1.4, "logits": 0.01}
    keys = jax.random.split(key, len(sizes))
    drawn = {
        name: jnp.zeros(shape, jnp.float32)
        if len(shape) == 1
        else jax.nn.initializers.orthogonal(gains.get(name, 1.0))(key, shape, jnp.float32)
        for key, (name, shape) in zip(keys, sizes.items(), strict=True)
    }
    remember = jnp.arange(4 * units) // units == 1  # a forget gate that starts open
    return Weights(**drawn)._replace(gates_bias=remember.astype(jnp.float32))


def check_weights(weights: Weights, source: str) -> Weights:
    """Return the weights as float32; InputError if they are no agent or not finite (host side)."""
    if weights.gates_back.ndim != 2 or weights.logits.ndim != 2:
        raise InputError(f"{source} is not an agent: gates_back and logits must be matrices")
    sizes = shapes(weights.gates_back.shape[0], weights.logits.shape[1])
    if weights.logits.shape[1] < 3:
        raise InputError(f"{source} is not an agent: it needs at least 3 actions")
    for array, (name, shape) in zip(weights, sizes.items(), strict=True):
        if array.shape != shape or not np.issubdtype(array.dtype, np.floating):
            other = f"{name} is {array.dtype} {array.shape}, not float {shape}"
            raise InputError(f"{source} is not an agent: {other}")
        if not np.isfinite(array).all():
            raise InputError(f"{source} is damaged: {name} holds numbers that are not finite")
    return Weights(*(np.asarray(array, np.float32) for array in weights))


def load_weights(path: str | Path = "") -> Weights:
    """Read an agent's .npz file, the shipped one by default; InputError if it is none."""
    path = Path(path or SHIPPED_AGENT)
    if not path.exists():
        raise InputError(f"there is no agent {path}: train or convert one first")
    arrays = read_arrays(path, dict.fromkeys(Weights._fields, Column()), others=None)
    return check_weights(Weights(**arrays), str(path))


class Tables(NamedTuple):
    """Everything an episode looks up; state ``position * 4 + heading`` indexes the rows."""

    layout: jax.Array  # int8 [H, W]
    course: world.Course  # start and goal
    ahead: jax.Array  # int32 [4 H W], state after driving forward
    wins: jax.Array  # bool [4 H W], driving forward reaches the goal
    gates: jax.Array  # float32 [4 H W, 4 L], input of the LSTM's gates


def prepare(weights: Weights, layout: Array) -> Tables:
    """Compute once per layout (int8 [H, W]) what all its episodes share.

    Within one maze the LSTM's input depends on cell and heading alone, so all 4 H W inputs are
    worked out here and only looked up later.
    """
    course = world.longest_path(layout)
    width = layout.shape[1]
    kinds = world.canvas(layout, course.goal)
    states = jnp.arange(4 * layout.size, dtype=jnp.int32)
    cell, heading = states // 4, states % 4
    place = pad(cell, width, world.REACH)
    pose, wins = jax.vmap(world.step, (None, 0, None))(
        kinds, world.Pose(place, heading), world.FORWARD
    )
    ahead = pad(pose.position, width + 2 * world.REACH, -world.REACH) * 4 + heading
    views = world.image(jax.vmap(world.view, (None, 0, 0))(kinds, place, heading))
    gates = encode(weights, views, jax.nn.one_hot(heading, 4))
    return Tables(jnp.asarray(layout), course, ahead, wins, gates)
