"""Solutions that are tiles: random ones, and mutations of others."""

import jax
import jax.numpy as jnp

MOST = 16  # tiles that a geometric draw changes: more come once in 65,000 mutations


def random_tiles(key: jax.Array, count: int, cells: int, choices: int) -> jax.Array:
    """Draw every tile evenly, int8 [count, cells]. Consumes `key`."""
    return jax.random.randint(key, (count, cells), 0, choices, jnp.int8)


def mutate_tiles(key: jax.Array, parents: jax.Array, choices: int, mutations: int) -> jax.Array:
    """Draw some tiles of each parent anew, evenly (which may give the same tile again).

    Args:
        key: consumed.
        parents: int8 [B, P].
        choices: tiles that there are.
        mutations: different cells drawn anew; 0 draws their number, geometric with mean 2.
    """
    many, cells = parents.shape
    place_key, number_key, tile_key = jax.random.split(key, 3)
    most = min(mutations or MOST, cells)
    # The places of the largest of random numbers: different ones, in random order.
    places = jax.lax.top_k(jax.random.uniform(place_key, parents.shape), most)[1]
    number = jnp.full(many, most)
    if not mutations:
        number = jax.random.geometric(number_key, 0.5, (many,))
    changed = jnp.arange(most)[None] < number[:, None]
    tiles = jax.random.randint(tile_key, places.shape, 0, choices, jnp.int8)
    target = jnp.where(changed, places, cells)  # others: out of bounds
    return parents.at[jnp.arange(many)[:, None], target].set(tiles, mode="drop")
