"""A convolution whose gradients are fast inside compiled loops on a CPU, too."""

import functools

import jax
import jax.numpy as jnp
from flax import linen as nn

LAYOUT = ("NHWC", "HWIO", "NHWC")


def _pad(kernel: int, stride: int) -> int:
    """Give the zeros on each side that keep the size, or divide it by the stride."""
    return (kernel - stride + 1) // 2


@functools.partial(jax.custom_vjp, nondiff_argnums=(2,))
def convolve(maps: jax.Array, kernel: jax.Array, stride: int) -> jax.Array:
    """Convolve float32 [B, H, W, C] with a square kernel [k, k, C, F].

    In a compiled loop XLA has no fast code on CPUs for the gradient by the kernel: 15 to 40 times
    slower than outside of one. Here that gradient is one product of matrices.

    Returns:
        float32 [B, H // stride, W // stride, F] where the kernel is odd with a stride of 1 and
        even with a stride of 2; every cell is seen, those of odd sides too.

    Raises:
        AssertionError: the kernel is even with a stride of 1: the size could not stay.
    """
    assert stride > 1 or kernel.shape[0] % 2, "an even kernel has no centre"
    around = (_pad(kernel.shape[0], stride),) * 2
    return jax.lax.conv_general_dilated(
        maps, kernel, (stride, stride), (around, around), dimension_numbers=LAYOUT
    )


def _forward(
    maps: jax.Array, kernel: jax.Array, stride: int
) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
    return convolve(maps, kernel, stride), (maps, kernel)


def _backward(
    stride: int, kept: tuple[jax.Array, jax.Array], gradient: jax.Array
) -> tuple[jax.Array, jax.Array]:
    maps, kernel = kept
    size, around = kernel.shape[0], _pad(kernel.shape[0], stride)
    if stride == 1:  # the convolution with the kernel turned around
        turned = kernel[::-1, ::-1].transpose(0, 1, 3, 2)
        by_maps = convolve(gradient, turned, 1)
    else:
        by_maps = jax.linear_transpose(
            lambda maps: jax.lax.conv_general_dilated(
                maps, kernel, (stride, stride), ((around, around),) * 2, dimension_numbers=LAYOUT
            ),
            maps,
        )(gradient)[0]
    rows, cols = gradient.shape[1:3]
    padded = jnp.pad(maps, ((0, 0), (around, around), (around, around), (0, 0)))
    seen = [  # what each weight of the kernel was multiplied with
        padded[
            :, i : i + stride * (rows - 1) + 1 : stride, j : j + stride * (cols - 1) + 1 : stride
        ]
        for i in range(size)
        for j in range(size)
    ]
    columns = jnp.concatenate(seen, axis=-1).reshape(-1, size * size * maps.shape[-1])
    by_kernel = columns.T @ gradient.reshape(-1, gradient.shape[-1])
    return by_maps, by_kernel.reshape(kernel.shape)


convolve.defvjp(_forward, _backward)


class Convolution(nn.Module):
    """`convolve` as a layer.

    Attributes:
        features: channels F of the result.
        size: width of the kernel: odd with a stride of 1, even with a stride of 2.
        stride: cells between the centres.
        bias: whether a number is added to each channel.
    """

    features: int
    size: int = 3
    stride: int = 1
    bias: bool = True

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
