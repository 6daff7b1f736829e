"""The surrogate's convolution and its gradients against jax's own, and the sizes of its maps."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from search_harness import QUICK

from qdenv.surrogates.networks import LAYOUT, MapPredictor, ScorePredictor, convolve, fill_up


def own(maps, kernel, stride):
    """Convolve as jax does; so many zeros around that the size stays, or is halved."""
    zeros = {(1, 1): 0, (3, 1): 1, (5, 1): 2, (4, 2): 1}[kernel.shape[0], stride]
    around = ((zeros, zeros), (zeros, zeros))
    return jax.lax.conv_general_dilated(
        maps, kernel, (stride, stride), around, dimension_numbers=LAYOUT
    )


def by_hand(maps, kernel, stride, zeros):
    """Convolve with loops over the cells."""
    size = kernel.shape[0]
    padded = np.pad(maps, ((0, 0), (zeros, zeros), (zeros, zeros), (0, 0)))
    rows = range(0, padded.shape[1] - size + 1, stride)
    cols = range(0, padded.shape[2] - size + 1, stride)
    windows = [[padded[:, i : i + size, j : j + size] for j in cols] for i in rows]
    return np.array([[np.einsum("bijc,ijcf->bf", w, kernel) for w in row] for row in windows])


def drawn(*shape, seed=0):
    return np.random.default_rng(seed).normal(size=shape).astype(np.float32)


@pytest.mark.parametrize(("size", "stride"), [(1, 1), (3, 1), (5, 1), (4, 2)])
@pytest.mark.parametrize("side", [(8, 8), (7, 12)])
def test_result_and_gradients_are_those_of_jax_itself(size, stride, side):
    maps, kernel = drawn(2, *side, 3), drawn(size, size, 3, 5, seed=1)

    @functools.partial(jax.jit, compiler_options=QUICK)
    def both(maps, kernel):
        ours, pull = jax.vjp(lambda m, k: convolve(m, k, stride), maps, kernel)
        theirs, own_pull = jax.vjp(lambda m, k: own(m, k, stride), maps, kernel)
        gradient = jnp.asarray(drawn(*theirs.shape, seed=2))
        return (ours, *pull(gradient)), (theirs, *own_pull(gradient))

    for one, other in zip(*both(maps, kernel), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-5 * float(np.abs(other).max()))


@pytest.mark.parametrize(("size", "stride", "zeros"), [(3, 1, 1), (4, 2, 1)])
def test_a_convolution_is_the_sum_over_each_window(size, stride, zeros):
    maps, kernel = drawn(2, 7, 8, 3), drawn(size, size, 3, 4, seed=1)
    expected = by_hand(maps, kernel, stride, zeros).transpose(2, 0, 1, 3)
    np.testing.assert_allclose(convolve(maps, kernel, stride), expected, atol=1e-5)


def test_a_stride_of_two_halves_odd_sides_downwards_and_still_sees_every_cell():
    for side in (2, 3, 5, 8):
        kernel, maps = np.ones((4, 4, 1, 1), np.float32), np.ones((1, side, side, 1), np.float32)
        assert jax.eval_shape(lambda m: convolve(m, kernel, 2), maps).shape[1:3] == (side // 2,) * 2  # noqa: B023
        seen = jax.jit(jax.grad(lambda m: convolve(m, kernel, 2).sum()))(maps)  # noqa: B023
        assert (np.asarray(seen) > 0).all()


@pytest.mark.parametrize(("size", "stride"), [(2, 1), (4, 1), (3, 2), (2, 2), (6, 3)])
def test_a_kernel_that_would_give_another_size_is_refused(size, stride):
    with pytest.raises(AssertionError):
        convolve(jnp.zeros((1, 6, 6, 1)), jnp.zeros((size, size, 1, 1)), stride)


def test_gradients_inside_a_compiled_loop_are_those_outside():
    maps, kernel = drawn(2, 6, 6, 2), drawn(4, 4, 2, 3, seed=1)

    def slope(kernel):
        return jax.grad(lambda k: jnp.square(convolve(maps, k, 2)).sum())(kernel)

    inside = jax.jit(lambda k: jax.lax.fori_loop(0, 3, lambda _, k: k - 0.01 * slope(k), k))(kernel)
    outside, once = kernel, jax.jit(slope)
    for _ in range(3):
        outside = outside - 0.01 * once(outside)
    np.testing.assert_allclose(inside, outside, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(
    ("side", "filled"), [((1, 1), 8), ((8, 8), 8), ((9, 3), 16), ((16, 16), 16), ((33, 36), 64)]
)
def test_maps_are_filled_up_to_a_square_whose_side_is_a_power_of_two(side, filled):
    maps = drawn(2, *side, 3)
    square = np.asarray(fill_up(maps))
    assert square.shape == (2, filled, filled, 3)
    np.testing.assert_array_equal(square[:, : side[0], : side[1]], maps)
    assert np.count_nonzero(square) == np.count_nonzero(maps)


def sizes_of(network, shape):
    blank = jax.eval_shape(lambda: network.init(jax.random.key(0), jnp.zeros(shape), False))
    return sum(np.prod(leaf.shape, dtype=int) for leaf in jax.tree.leaves(blank["params"]))


def test_the_published_networks_have_the_published_numbers_of_weights():
    # Warehouse: 33 x 36 cells of 4 kinds, fed to the score network as 64 x 64 with one channel
    # more. Kernels, two numbers for each normalised channel, biases where nothing is normalised.
    inside = 4 * (9 * 64 * 64 + 2 * 64)
    first, last = 9 * 4 * 64 + 2 * 64, 64 * 4 + 4
    assert sizes_of(MapPredictor(64, 2, 4), (1, 33, 36, 4)) == first + inside + last
    halvings = 16 * 5 * 64 + sum(16 * c * 2 * c + 2 * 2 * c for c in (64, 128, 256))
    assert sizes_of(ScorePredictor(64, 4), (1, 33, 36, 5)) == halvings + 16 * 512 * 4 + 4
