"""The neural cellular automaton: a small convolutional network applied again and again.

One step is three convolutions with zero padding, ReLU, ReLU, sigmoid (Zhang et al. 2023,
"Arbitrarily scalable environment generators via neural cellular automata", appendix C.1.1,
https://arxiv.org/abs/2310.18622). The real-valued output is fed back; tiles are chosen only
after the last step.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

import chex
import jax
import jax.numpy as jnp
import numpy as np
from flax import linen as nn
from jax.flatten_util import ravel_pytree

from qdenv.generators import (
    Canvas,
    Drive,
    Generator,
    GuidedNcaConfig,
    NcaConfig,
    UpdateConfig,
    choose_tiles,
    draw_nothing,
)
from qdenv.grid import NUM_MOVES, parse
from qdenv.guidance import NUM_SMOOTH, scaled_costs, smooth_logarithms
from qdenv.types import Array, InputError

# The numbers of an exact automaton are multiples of these fractions, so small that no sum has more
# than 24 bits: float32 adds such numbers without rounding, in any order. In other automata the last
# bit, which depends on the order, is amplified by the iteration until other tiles are drawn.
_WEIGHT, _HIDDEN, _OUTPUT = 512, 32, 1024
_MAX_WEIGHT, _MAX_HIDDEN = 2, 16  # weights, and what a hidden layer gives, are smaller
# Largest sums of absolute weights into a channel, of the first layer and of the others:
# (30 * 1 + 2) * 512 * 1024 = (63 * 16 + 16) * 512 * 32 = 2^24.
_MAX_SUMS = (30, 63)
_LOGIT = 128  # steps per unit in the look-up table of the sigmoid
# How many powers of a half are tried until a layer's weights are that small. A rectified layer of
# half the weights gives half the numbers: sums of the last one, doubled as often, are the same.
_HALVINGS = 8
_STEPS = np.arange(-8 * _LOGIT, 8 * _LOGIT) / _LOGIT
_SIGMOID = (np.round(_OUTPUT / (1 + np.exp(-_STEPS))) / _OUTPUT).astype(np.float32)

# How much more the numbers of smooth costs count than weights: a spread of 0.01 leaves most floors
# nearly as they are, and lanes still move.
_QUICKER = 8


def round_weights(variables: Any) -> tuple[Any, jax.Array]:
    """Round the weights of an automaton to those of an exact one, halved until sums are exact.

    Returns them, and by how much the sums of its last layer are multiplied: a power of two.
    """
    layers, scale = {}, jnp.float32(1)
    limit = _MAX_WEIGHT * _WEIGHT - 1
    for number, (name, layer) in enumerate(sorted(variables["params"].items())):
        factors = _WEIGHT * 0.5 ** np.arange(_HALVINGS, dtype=np.float32)
        halved = layer["kernel"][None] * factors[:, None, None, None, None]
        rounded = jnp.abs(jnp.round(halved))
        # Of whole numbers: which sums fit does not depend on the order of adding either.
        most = _MAX_SUMS[min(number, 1)] * _WEIGHT
        fits = (rounded.sum((1, 2, 3)).max(-1) <= most) & (rounded.max((1, 2, 3, 4)) <= limit)
        halvings = jnp.where(fits.any(), fits.argmax(), _HALVINGS - 1)
        kernel = jnp.clip(jnp.round(halved[halvings]), -limit, limit)
        sums = jnp.maximum(jnp.abs(kernel).sum((0, 1, 2), keepdims=True), 1)
        kernel = jnp.trunc(kernel * jnp.minimum(1, most / sums))  # where nothing fits
        scale *= jnp.asarray(_WEIGHT / factors)[halvings]  # 1, 2, 4, ..: exact, unlike exp2
        # A bias is added to sums, which are multiples of smaller fractions than the weights.
        fraction = jnp.minimum(_WEIGHT * scale, _WEIGHT * _HIDDEN)
        bias = jnp.clip(layer["bias"] / scale, -_MAX_WEIGHT, _MAX_WEIGHT)
        layers[name] = {"bias": jnp.round(bias * fraction) / fraction, "kernel": kernel / _WEIGHT}
    return {"params": layers}, scale


class NCA(nn.Module):
    """One step of the automaton, [H, W, K] -> [H, W, K] in [0, 1]."""

    kinds: int  # kinds of tile K, the channels in and out
    # width of each convolution's kernel; the appendix uses (3, 3, 3), the published code (3, 1, 1)
    kernel_sizes: tuple[int, ...] = (3, 3, 3)
    hidden: int = 32  # channels between the convolutions
    exact: bool = False  # whether it rounds what its layers give, after `round_weights`

    @nn.compact
    def __call__(self, cells: Array, scale: Array | float = 1) -> Array:
        """Apply one step to the real-valued cells [H, W, K]; `scale` is that of exact weights."""
        last = len(self.kernel_sizes) - 1
        for layer, size in enumerate(self.kernel_sizes):
            width = self.kinds if layer == last else self.hidden
            # The automaton iterates its own output: full precision keeps a layout the same on
            # devices whose fast convolutions round more coarsely.
            convolution = nn.Conv(
                width, (size, size), padding="SAME", precision=jax.lax.Precision.HIGHEST
            )
            cells = convolution(cells)
            if not self.exact:
                cells = nn.sigmoid(cells) if layer == last else nn.relu(cells)
            elif layer == last:
                half = len(_SIGMOID) // 2
                fine = jnp.clip(jnp.round(cells * (scale * _LOGIT)), -half, half - 1)
                cells = jnp.asarray(_SIGMOID)[fine.astype(jnp.int32) + half]
            else:
                fine = jnp.clip(jnp.round(cells * _HIDDEN), 0, _MAX_HIDDEN * _HIDDEN - 1)
                cells = fine / _HIDDEN
        return cells


def make_automaton(
    kinds: int, kernel_sizes: tuple[int, ...] = (3, 3, 3), hidden: int = 32, exact: bool = False
) -> tuple[int, Callable[[jax.Array, Array, Array | int], jax.Array]]:
    """Build the automaton of an architecture; it works on canvases of any size.

    An `exact` one draws the same on every version and device, other than one that is not. Returns
    the number of parameters P, and a function from a flat vector of them (float32 [P]), a
    canvas to start from (float32 [H, W, K]) and a number of steps to cells (float32 [H, W, K]).
    """
    module = NCA(kinds, tuple(kernel_sizes), hidden, exact)
    size, unravel = _parameters_of(module, kinds)

    def grow(parameters: jax.Array, start: Array, steps: Array | int) -> jax.Array:
        chex.assert_shape(parameters, (size,))
        chex.assert_shape(start, (None, None, kinds))
        weights, scale = unravel(parameters), jnp.float32(1)
        if exact:
            weights, scale = round_weights(weights)
        return jax.lax.fori_loop(
            0, steps, lambda _, cells: module.apply(weights, cells, scale), start
        )

    return size, grow


def _parameters_of(module: nn.Module, channels: int) -> tuple[int, Callable[[jax.Array], Any]]:
    """Count the parameters P of a module [H, W, channels]; return what cuts a vector [P] up."""
    # The shapes alone say how: no random weights are ever drawn.
    shapes = jax.eval_shape(module.init, jax.random.key(0), jnp.zeros((1, 1, channels)))
    flat, unravel = ravel_pytree(jax.tree.map(lambda one: np.zeros(one.shape, one.dtype), shapes))
    return flat.size, unravel


def add_channels(
    solution: np.ndarray, kinds: int, extra: int, kernel_sizes: Sequence[int], hidden: int
) -> np.ndarray:
    """Give an automaton of `kinds` channels some more, which nothing reads and zeros draw.

    `solution` is float [P]; the automaton draws the same tiles as before.
    """
    parts, begin, last = [], 0, len(kernel_sizes) - 1
    for layer, size in enumerate(kernel_sizes):
        ins, outs = (kinds if layer == 0 else hidden), (kinds if layer == last else hidden)
        more = [(0, extra if layer == 0 else 0), (0, extra if layer == last else 0)]
        # As flax sorts them: the bias of a layer before its kernel.
        for shape, room in (((outs,), more[1:]), ((size, size, ins, outs), [(0, 0)] * 2 + more)):
            end = begin + int(np.prod(shape))
            parts.append(np.pad(solution[begin:end].reshape(shape), room).reshape(-1))
            begin = end
    return np.concatenate(parts)


def seed_canvas(block: Sequence[str], rows: int, cols: int, generated: str) -> np.ndarray:
    """Draw the fixed start canvas: `block` in the middle of empty tiles, one-hot (Figure 9).

    Returns float32 [rows, cols, K]; `generated` are the K symbols that the NCA draws, the empty
    tile first. Raises InputError if the canvas is smaller than the block.
    """
    tiles = parse(block, generated)
    height, width = tiles.shape
    short = max(height - rows, 0), max(width - cols, 0)
    if any(short):
        text = "{} x {} (rows x columns) for the seed block of {} x {}".format(*short, *tiles.shape)
        raise InputError(f"the layout is too small by {text}: give a larger size")
    canvas = np.zeros((rows, cols), np.int8)
    top, left = (rows - height) // 2, (cols - width) // 2
    canvas[top : top + height, left : left + width] = tiles
    return np.eye(len(generated), dtype=np.float32)[canvas]


def nca(config: NcaConfig, canvas: Canvas) -> Generator:
    """Make the generator that grows a canvas from its seed block, which must fit on it.

    One that is guided grows five more channels, which begin and end between 0 and 1: from a tenth
    of the cost of a move to the tenfold. A cell has the costs that it grew also where the repair
    changes its tile; those of the frame are the nearest cell's. Instead of these channels, `smooth`
    costs have thirty numbers at the end of the parameters.
    """
    start = seed_canvas(canvas.seed_block, canvas.rows, canvas.cols, canvas.tiles)
    kinds, guided = len(canvas.tiles), isinstance(config, GuidedNcaConfig)
    smooth = getattr(config, "smooth", False)
    if guided and not smooth:
        start = np.pad(start, ((0, 0), (0, 0), (0, NUM_MOVES)), constant_values=0.5)
    size, grow_one = make_automaton(
        start.shape[-1], config.kernel_sizes, config.hidden, config.arithmetic == "exact"
    )

    def grow(solutions: jax.Array, steps: jax.Array | int) -> jax.Array:
        # One solution after the other: its numbers then cannot depend on how many grow beside it,
        # and a convolution with its own weights per item is no faster batched on a CPU.
        cells = jax.lax.map(lambda one: grow_one(one[:size], start, steps), solutions)
        return choose_tiles(cells[..., :kinds])

    def frames(solutions: jax.Array, steps: int) -> jax.Array:
        def one(weights: jax.Array) -> jax.Array:
            def step(cells: jax.Array, _: None) -> tuple[jax.Array, jax.Array]:
                return grow_one(weights[:size], cells, 1), choose_tiles(cells[..., :kinds])

            last, before = jax.lax.scan(step, jnp.asarray(start), None, length=steps)
            return jnp.concatenate([before, choose_tiles(last[..., :kinds])[None]])

        return jax.lax.map(one, solutions)

    def guide(solution: jax.Array, steps: Any, layout: jax.Array, drive: Drive) -> jax.Array:
        base = getattr(config, "base", "")
        if smooth:
            numbers = _QUICKER * solution[size:]
            return scaled_costs(smooth_logarithms(numbers, layout.shape, base), base)
        cells = grow_one(solution, start, steps)
        logarithms = 2 * jnp.moveaxis(cells[..., kinds:], -1, 0) - 1
        edges = [(more // 2, more // 2) for more in np.subtract(layout.shape, start.shape[:2])]
        return scaled_costs(jnp.pad(logarithms * math.log(10), ((0, 0), *edges), "edge"), base)

    total = size + NUM_SMOOTH * smooth
    return Generator(total, config.steps, grow, frames=frames, guide=guide if guided else None)


class Update(nn.Module):
    """Changes of the logarithms of costs, [H, W, 11] -> [H, W, 5] within (-1, 1).

    The inputs are these logarithms, how often each move was made, and whether a robot was there.
    """

    kernel_sizes: Sequence[int]
    hidden: int  # channels between the convolutions

    @nn.compact
    def __call__(self, cells: Array) -> Array:
        """Apply the network once."""
        for size in self.kernel_sizes[:-1]:
            cells = nn.relu(nn.Conv(self.hidden, (size, size), padding="SAME")(cells))
        size = self.kernel_sizes[-1]
        return nn.tanh(nn.Conv(NUM_MOVES, (size, size), padding="SAME")(cells))


def update(config: UpdateConfig, canvas: Canvas) -> Generator:
    """Make the generator whose parameters are the weights of an update model.

    With zeros the costs stay those of its base.
    """
    model = Update(config.kernel_sizes, config.hidden)
    size, unravel = _parameters_of(model, 2 * NUM_MOVES + 1)

    def guide(solution: jax.Array, steps: Any, layout: jax.Array, drive: Drive) -> jax.Array:
        weights = unravel(solution)
        logarithms = jnp.zeros((NUM_MOVES, *layout.shape))
        for number in range(config.rounds):
            moves = drive(scaled_costs(logarithms, config.base), number)
            free = moves.sum(axis=0) > 0
            # One is what a move would be made if all were made equally often.
            share = moves / jnp.maximum(moves.sum(), 1) * NUM_MOVES * free.sum()
            inputs = jnp.concatenate([logarithms, jnp.log1p(share), free[None]])
            change: Any = model.apply(weights, jnp.moveaxis(inputs, 0, -1))
            logarithms += jnp.moveaxis(change, -1, 0)
        return scaled_costs(logarithms, config.base)

    return Generator(size, 0, draw_nothing(canvas), guide=guide)
