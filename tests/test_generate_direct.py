"""The direct encoding: a solution is its tiles, whatever the domain's frame."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qdenv.domains.base import find_domain
from qdenv.generators import GENERATORS, Canvas, DirectConfig

DOMAINS = ("warehouse-even", "warehouse-uneven", "manufacturing", "maze-walls", "maze-entropy")


@pytest.mark.parametrize("name", DOMAINS)
def test_exactly_the_tiles_of_a_solution_are_drawn_inside_the_frame(name):
    domain = find_domain(name)
    generator = GENERATORS.make(DirectConfig(), domain.canvas)
    rows, cols = domain.generated_shape
    kinds = len(domain.generated)
    assert (generator.size, generator.choices, generator.steps) == (rows * cols, kinds, 0)
    tiles = np.random.default_rng(0).integers(0, kinds, (3, rows, cols))
    drawn = generator.grow(jnp.asarray(tiles.reshape(3, -1), jnp.float32), 50)
    assert drawn.dtype == jnp.int8
    np.testing.assert_array_equal(drawn, tiles)
    down, right = domain.margin
    framed, frame = (
        np.asarray(jax.vmap(domain.frame)(jnp.asarray(maps, jnp.int8)))
        for maps in (tiles, np.zeros_like(tiles))
    )
    assert framed.shape[1:] == domain.shape
    inside = np.zeros(domain.shape, bool)
    inside[down : domain.shape[0] - down, right : domain.shape[1] - right] = True
    np.testing.assert_array_equal(framed[:, inside].reshape(tiles.shape), tiles)
    np.testing.assert_array_equal(framed[:, ~inside], frame[:, ~inside])


def test_numbers_between_tiles_are_rounded_and_those_beyond_kept_to_the_alphabet():
    generator = GENERATORS.make(DirectConfig(), Canvas(2, 3, ".@e", (".",)))
    solution = jnp.array([[-7.0, 0.4, 0.6, 1.4, 2.0, 1e9]])
    np.testing.assert_array_equal(generator.grow(solution, 1), [[[0, 0, 1], [1, 2, 2]]])


def test_every_number_of_tiles_that_an_alphabet_has_survives_the_way_to_a_float_and_back():
    symbols = "".join(chr(33 + number) for number in range(90))
    generator = GENERATORS.make(DirectConfig(), Canvas(9, 10, symbols, ("!",)))
    tiles = np.arange(90, dtype=np.int8)
    drawn = generator.grow(jnp.asarray(tiles[None], jnp.float32), 0)
    np.testing.assert_array_equal(np.asarray(drawn).ravel(), tiles)
