"""The surrogate's networks: maps from maps, numbers from maps, on a convolution of their own.

Bhatt, Tjanaka, Fontaine and Nikolaidis 2022, "Deep surrogate assisted generation of environments",
https://arxiv.org/abs/2206.04199, with the sizes that Zhang et al. 2023 state.
"""

import functools

import jax
import jax.numpy as jnp
from flax import linen as nn

LAYOUT = ("NHWC", "HWIO", "NHWC")


def _plain(maps: jax.Array, kernel: jax.Array, stride: int, around: int) -> jax.Array:
    """Convolve with as many zeros around; fast in compiled loops, unlike its gradients."""
    zeros = ((around, around), (around, around))
    return jax.lax.conv_general_dilated(
        maps, kernel, (stride, stride), zeros, dimension_numbers=LAYOUT
    )


@functools.partial(jax.custom_vjp, nondiff_argnums=(2,))
def convolve(maps: jax.Array, kernel: jax.Array, stride: int) -> jax.Array:
    """Convolve float32 [B, H, W, C] with a square kernel [k, k, C, F], k odd.

    A stride of 2, with a kernel of width 4, halves the sides; the last row and column of odd sides
    count, too. In a compiled loop XLA has no fast code on CPUs for the gradients. Here the gradient
    by the kernel is one product of matrices, that by the maps another convolution. The result is
    float32 [B, H // stride, W // stride, F].
    """
    size = kernel.shape[0]
    assert (size % 2, stride) == (1, 1) or (size, stride) == (4, 2), "no such convolution"
    # This number of zeros on each side preserves the size, or divides it by the stride.
    return _plain(maps, kernel, stride, (size - stride + 1) // 2)


def _backward(
    stride: int, inputs: tuple[jax.Array, jax.Array], gradient: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Compute the gradients by the maps and by the kernel."""
    maps, kernel = inputs
    (_, rows, cols, channels), size = maps.shape, kernel.shape[0]
    many, around = size // stride, (size - stride + 1) // 2
    # By the maps: the gradient convolved with the kernel turned around, once for each place in a
    # stride, because cells of one parity are reached by every second row and column of the kernel
    # alone.
    parts = kernel.reshape(many, stride, many, stride, channels, -1)[::-1, :, ::-1]
    turned = parts.transpose(0, 2, 5, 1, 3, 4).reshape(many, many, -1, stride**2 * channels)
    wide = _plain(gradient, turned, 1, many - 1)
    apart = wide.reshape(*wide.shape[:3], stride, stride, channels).transpose(0, 1, 3, 2, 4, 5)
    whole = apart.reshape(len(gradient), stride * wide.shape[1], stride * wide.shape[2], channels)
    by_maps = whole[:, around : around + rows, around : around + cols]
    # By the kernel: the gradient times the cells that each weight was multiplied with.
    padded = jnp.pad(maps, ((0, 0), (around, around), (around, around), (0, 0)))
    down, right = (stride * (side - 1) + 1 for side in gradient.shape[1:3])
    windows = [
        padded[:, i : i + down : stride, j : j + right : stride]
        for i in range(size)
        for j in range(size)
    ]
    columns = jnp.concatenate(windows, axis=-1).reshape(-1, size * size * channels)
    return by_maps, (columns.T @ gradient.reshape(-1, gradient.shape[-1])).reshape(kernel.shape)


convolve.defvjp(
    lambda maps, kernel, stride: (convolve(maps, kernel, stride), (maps, kernel)), _backward
)


# Flax names parameters after this class, and draws them by name: another name, other numbers.
class Convolution(nn.Module):
    """`convolve` as a layer."""

    features: int  # channels F of the result
    size: int = 3  # width of the kernel: odd with a stride of 1, 4 with a stride of 2
    stride: int = 1  # cells between the centres
    bias: bool = True  # whether a number is added to each channel

    @nn.compact
    def __call__(self, maps: jax.Array) -> jax.Array:
        """Convolve float32 [B, H, W, C]."""
        shape = (self.size, self.size, maps.shape[-1], self.features)
        result = convolve(
            maps, self.param("kernel", nn.initializers.lecun_normal(), shape), self.stride
        )
        if self.bias:
            offset = self.param("bias", nn.initializers.zeros, (self.features,))
            result += offset.reshape(1, 1, 1, -1)
        return result


_SLOPE = 0.2  # of the leaky rectifier below zero
_SMALLEST = 4  # side of the last map
# Torch's numbers, from which the published sizes come.
_Normalisation = functools.partial(nn.BatchNorm, momentum=0.9, epsilon=1e-5)


class MapPredictor(nn.Module):
    """A residual network from a map to a map of the same size."""

    channels: int  # hidden channels
    blocks: int  # residual blocks of two convolutions each
    outputs: int  # channels of the result

    @nn.compact
    def __call__(self, maps: jax.Array, train: bool) -> jax.Array:
        """Map float32 [B, H, W, K] to [B, H, W, outputs]."""
        known = not train  # statistics: those of the minibatch, or those known from learning
        hidden = nn.relu(_Normalisation(known)(Convolution(self.channels, bias=False)(maps)))
        for _ in range(self.blocks):
            inner = nn.relu(_Normalisation(known)(Convolution(self.channels, bias=False)(hidden)))
            inner = _Normalisation(known)(Convolution(self.channels, bias=False)(inner))
            hidden = nn.relu(hidden + inner)
        return Convolution(self.outputs, size=1)(hidden)


class ScorePredictor(nn.Module):
    """A convolutional network that halves a map until it is 4 x 4, then linear heads."""

    channels: int  # of the first layer; each further layer doubles them
    heads: int  # numbers predicted

    @nn.compact
    def __call__(self, maps: jax.Array, train: bool) -> jax.Array:
        """Map float32 [B, H, W, K] to [B, heads]; maps are filled up to a square first."""
        maps = fill_up(maps)
        channels = self.channels
        while maps.shape[1] > _SMALLEST:
            first = channels == self.channels
            maps = Convolution(channels, size=4, stride=2, bias=False)(maps)
            maps = nn.leaky_relu(maps if first else _Normalisation(not train)(maps), _SLOPE)
            channels *= 2
        return nn.Dense(self.heads)(maps.reshape(len(maps), -1))


def fill_up(maps: jax.Array) -> jax.Array:
    """Add zeros below and right of maps [B, H, W, K] up to a square whose side is a power of 2."""
    rows, cols = maps.shape[1:3]
    side = 1 << (max(rows, cols, 2 * _SMALLEST) - 1).bit_length()
    return jnp.pad(maps, ((0, 0), (0, side - rows), (0, side - cols), (0, 0)))
