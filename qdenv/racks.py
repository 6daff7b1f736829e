"""Racks in rows: a floor of the kind that people draw, in twelve numbers.

Racks are one or two shelves deep and up to sixteen long, with aisles of one width and cross
aisles of another between them. They fill the area from the stations on until all shelves have a
place, so that ways are short; how much the nearest station and the directions count is searched.
"""

import jax
import jax.numpy as jnp
import numpy as np

from qdenv.generators import Canvas, Generator, RacksConfig
from qdenv.grid import MOVES, inside_frame, shift
from qdenv.simulation.mapf.distances import goal_distances
from qdenv.simulation.mapf.planner import distance_type
from qdenv.types import InputError

_SIZE = 12  # numbers of a solution
_SPREAD = 2.0  # numbers between this and its negative choose among the values of a size
# A mean distance counts `_WHOLE` times, another field up to half as much; all sums are whole
# numbers, so that cells are in the same order everywhere.
_WHOLE, _FINE = 64, 255


def racks(config: RacksConfig, canvas: Canvas) -> Generator:
    """Make the generator of racks in rows on the area of a domain.

    Raises InputError if shelves and endpoints are not what is drawn there.
    """
    domain = canvas.domain
    if domain is None or canvas.tiles[:3] != ".@e":
        raise InputError("racks draws shelves and endpoints: of hall and warehouse-even, -uneven")
    shape, shelves = (canvas.rows, canvas.cols), domain.config.shelves
    empty = np.asarray(domain.frame(np.zeros(shape, np.int8)))
    free = domain.drivable(empty)
    stations = np.flatnonzero(free & (empty > 0))
    if not stations.size:
        raise InputError("racks fills a floor from its stations on: give a --plan that has some")
    every = jnp.ones(stations.size, bool)
    ways = np.asarray(goal_distances(jnp.asarray(free), jnp.asarray(stations), every))
    ways = np.asarray(inside_frame(ways.T.reshape(*free.shape, -1), domain.margin))
    mean, nearest = ways.mean(axis=-1), ways.min(axis=-1)
    possible = inside_frame(free & (empty == 0), domain.margin)
    possible &= (ways < distance_type(free.size)[1]).all(axis=-1)
    row, column = np.indices(shape)
    fields = np.stack([mean, nearest, row, column])
    fields = np.where(possible, fields, 0)
    most = np.maximum(fields.max(axis=(1, 2), keepdims=True), 1)
    fields = np.round(_FINE * fields / most).astype(np.int32)
    far = np.iinfo(np.int32).max

    def draw(solution: jax.Array) -> jax.Array:
        def choose(number: int, values: int) -> jax.Array:
            share = (solution[number] + _SPREAD) / (2 * _SPREAD)
            return jnp.clip(jnp.floor(share * values), 0, values - 1).astype(jnp.int32)

        depth, aisle, length, cross = (
            1 + choose(number, values) for number, values in enumerate((2, 3, 16, 3))
        )
        upright = solution[4] > 0
        over, along = jnp.where(upright, column, row), jnp.where(upright, row, column)
        over, along = over + choose(5, 5), along + choose(6, 19)
        rack = (over % (depth + aisle) < depth) & (along % (length + cross) < length)
        rack &= possible & (nearest > choose(7, 6))
        counts = jnp.round(jnp.clip(solution[8:11] / _SPREAD, -1, 1) * _WHOLE / 2)
        order = _WHOLE * fields[0] + (counts.astype(jnp.int32)[:, None, None] * fields[1:]).sum(0)
        first = jnp.argsort(jnp.where(rack, order, far).reshape(-1), stable=True)[:shelves]
        shelf = jnp.zeros(rack.size, bool).at[first].set(True).reshape(shape) & rack
        right, left, down, up = (shift(shelf, move, False) for move in MOVES)
        rows, columns = up | down, left | right
        sides, ends = jnp.where(upright, columns, rows), jnp.where(upright, rows, columns)
        served = sides | (ends & (solution[11] > 0))
        return jnp.where(shelf, 1, jnp.where(served & possible, 2, 0)).astype(jnp.int8)

    return Generator(_SIZE, 0, lambda solutions, steps: jax.vmap(draw)(solutions))
