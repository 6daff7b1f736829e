"""The surrogate's networks: maps from maps, numbers from maps.

Bhatt, Tjanaka, Fontaine and Nikolaidis 2022, "Deep surrogate assisted generation of environments",
https://arxiv.org/abs/2206.04199, with the sizes that Zhang et al. 2023 state.
"""

import jax
import jax.numpy as jnp
from flax import linen as nn

from qdenv.surrogate.convolution import Convolution

SLOPE = 0.2  # of the leaky rectifier below zero
SMALLEST = 4  # side of the last map


def normalise(train: bool) -> nn.BatchNorm:
    """Make a batch normalisation with torch's numbers, from which the published sizes come."""
    return nn.BatchNorm(use_running_average=not train, momentum=0.9, epsilon=1e-5)


class MapPredictor(nn.Module):
    """A residual network from a map to a map of the same size."""

    channels: int  # hidden channels
    blocks: int  # residual blocks of two convolutions each
    outputs: int  # channels of the result

    @nn.compact
    def __call__(self, maps: jax.Array, train: bool) -> jax.Array:
        """Map float32 [B, H, W, K] to [B, H, W, outputs]."""
        hidden = nn.relu(normalise(train)(Convolution(self.channels, bias=False)(maps)))
        for _ in range(self.blocks):
            inner = nn.relu(normalise(train)(Convolution(self.channels, bias=False)(hidden)))
            inner = normalise(train)(Convolution(self.channels, bias=False)(inner))
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
        while maps.shape[1] > SMALLEST:
            first = channels == self.channels
            maps = Convolution(channels, size=4, stride=2, bias=False)(maps)
            maps = nn.leaky_relu(maps if first else normalise(train)(maps), SLOPE)
            channels *= 2
        return nn.Dense(self.heads)(maps.reshape(len(maps), -1))


def fill_up(maps: jax.Array) -> jax.Array:
    """Add zeros below and right of maps [B, H, W, K] up to a square whose side is a power of 2."""
    longest = max(*maps.shape[1:3], 2 * SMALLEST)
    side = 1 << (longest - 1).bit_length()
    rows, cols = maps.shape[1:3]
    return jnp.pad(maps, ((0, 0), (0, side - rows), (0, side - cols), (0, 0)))
