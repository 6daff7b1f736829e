"""The direct encoding: a solution is its tiles, one number per cell (DSAGE searches these)."""

import jax
import jax.numpy as jnp

from qdenv.generate.generator import Canvas, Generator
from qdenv.generate.settings import DirectConfig


def direct(config: DirectConfig, canvas: Canvas) -> Generator:
    """Make the generator whose parameters are the numbers of the tiles, row by row."""
    del config
    shape, choices = (canvas.rows, canvas.cols), len(canvas.tiles)

    def read(solutions: jax.Array, steps: jax.Array | int) -> jax.Array:
        del steps
        tiles = jnp.clip(jnp.round(solutions), 0, choices - 1).astype(jnp.int8)
        return tiles.reshape(-1, *shape)

    return Generator(canvas.rows * canvas.cols, 0, read, choices)
