"""Guidance: the cost of each move at each cell, by which robots prefer one way to another.

A cheap direction beside a dear one makes a lane (Zhang et al. 2024, "Guidance graph optimization
for lifelong multi-agent path finding", https://arxiv.org/abs/2402.01446). Costs change nothing
that a robot may do, but for a move without a finite cost, which is not allowed: a one-way lane.

Costs are float [5, H, W] in the order of `grid`: waiting, then right, left, down, up. Only their
ratios count.
"""

from __future__ import annotations

import math
import pkgutil
from collections.abc import Callable

import numpy as np

from qdenv.grid import DOWN, LEFT, MOVES, NUM_MOVES, RIGHT, UP, move_steps, shift
from qdenv.lazy import jax, jnp
from qdenv.types import Array, InputError

_ONE = 64  # the mean cost of a move as a whole number: from a 64th to 16 times the mean fits
_LEAST_ONE = 16  # its minimum, used where the dearest move does not fit
_MOST_SCALED = math.log(10)  # by how much generators change costs at most, as a logarithm
NUM_SMOOTH = 30  # numbers of `smooth_logarithms`
# How much more they count than the logarithm of a single cost: a search first finds where traffic
# should go, then each turn of its way.
_SMOOTHER = 3
_WIDTHS = {"none": 1, "crisscross": 1, "crisscross-pairs": 2}  # rows or columns of a lane
_CLOSED = 99.0  # doublings of the cost, of a move that is not allowed
BUCKETS = 1024  # above every whole cost of a move


def fixed_costs(costs: np.ndarray, traversable: np.ndarray) -> np.ndarray:
    """Round costs to whole numbers, in which host and XLA agree to the bit.

    `costs` (float [5, H, W]) are infinite for a move that is not allowed, `traversable` is bool
    [H, W]. Returns int32 [5, H, W], 64 for the mean cost of a move, 1 to 1023; 0 where a move is
    not allowed. Where the dearest would be above 1023, the mean is less, but 16 or more: costs
    that are all cut off at one value make no lanes. Raises InputError if a cost is negative,
    zero or no number, a robot may not wait somewhere, or one-way lanes cut a free cell off.
    """
    costs, free = np.asarray(costs, float), np.asarray(traversable, bool)
    if costs.shape != (NUM_MOVES, *free.shape):
        raise InputError(
            f"costs of moves have the shape {(NUM_MOVES, *free.shape)}, not {costs.shape}"
        )
    moves = existing_moves(free)
    if not (costs[moves] > 0).all() or np.isinf(costs[0][free]).any():
        raise InputError("costs of moves must be above zero, and finite for waiting")
    allowed = moves & np.isfinite(costs)
    fixed = np.zeros(costs.shape, np.int32)
    ratio = costs[allowed] / costs[allowed].mean()
    one = np.clip((BUCKETS - 1) / ratio.max(initial=1.0), _LEAST_ONE, _ONE)
    fixed[allowed] = np.clip(np.rint(ratio * one), 1, BUCKETS - 1)
    if (fixed[moves] == 0).any():
        _check_connected(fixed, free)
    return fixed


def scaled_costs(logarithms: Array, base: str) -> jax.Array:
    """Scale the costs of a named guidance, within a factor of ten, and round them; traceable.

    `logarithms` is float [5, H, W], that of a factor for each move at each cell, 0 for the
    guidance itself. Returns int32 [5, H, W], also for moves that do not exist.
    """
    shape = logarithms.shape[1:]
    start = GUIDANCE[base](np.ones(shape, bool), np.ones((1, 2, *shape)))
    start = np.ones((NUM_MOVES, *shape)) if start is None else start
    factors = jnp.exp(jnp.clip(logarithms, -_MOST_SCALED, _MOST_SCALED))
    return jnp.clip(jnp.rint(start * _ONE * factors), 1, BUCKETS - 1).astype(jnp.int32)


def smooth_logarithms(numbers: Array, shape: tuple[int, ...], base: str) -> jax.Array:
    """Return logarithms of factors of costs that vary smoothly over a floor of any size; traceable.

    Each is a quadratic function of the distances from the middle lines of the floor: one for
    waiting, and one for each direction in even lanes of the `base`, which is that of the direction
    back in odd lanes. Three times the `numbers` (float [30]) are their six coefficients. So a few
    numbers lead traffic away from where all ways cross, and give lanes their direction and
    strength. Returns float [5, H, W].
    """
    rows, cols = np.indices(shape)
    x, y = abs((2 * cols + 1) / shape[1] - 1), abs((2 * rows + 1) / shape[0] - 1)  # 0 to 1
    terms = jnp.asarray(np.stack([np.ones(shape), x, y, x * x, x * y, y * y]), jnp.float32)
    even = jnp.tensordot(_SMOOTHER * jnp.reshape(numbers, (NUM_MOVES, -1)), terms, 1)
    odd_row, odd_col = rows // _WIDTHS[base] % 2 == 1, cols // _WIDTHS[base] % 2 == 1
    odd = np.stack([np.zeros(shape, bool), odd_row, odd_row, odd_col, odd_col])
    return jnp.where(odd, even[np.array([0, LEFT, RIGHT, UP, DOWN])], even)


def unscaled_costs(fixed: np.ndarray, traversable: np.ndarray) -> np.ndarray:
    """Turn whole costs (int32 [5, H, W]) into costs in units of 64.

    Returns float [5, H, W], infinite for moves that do not exist or are not allowed.
    """
    allowed = existing_moves(traversable) & (fixed > 0)
    return np.where(allowed, fixed / _ONE, np.inf)


def existing_moves(traversable: np.ndarray) -> np.ndarray:
    """Return which moves exist (bool [5, H, W]): from a free cell to a free cell."""
    return np.stack([shift(traversable, move) for move in ((0, 0), *MOVES)]) & traversable


def preferences(costs: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Return by how many doublings the cheaper way between two cells is cheaper.

    `costs` ([5, H, W]) are zero or infinite where a move is not allowed, agents may drive on `free`
    (bool [H, W]). Returns float [2, H, W]: log2 of the cost back over the cost there, between each
    cell and the one at its right, and the one below it; positive where right or down is cheaper, 0
    between cells where no way is.
    """
    allowed = existing_moves(free) & (costs > 0) & np.isfinite(costs)
    doublings = np.where(allowed, np.log2(np.where(allowed, costs, 1.0)), _CLOSED)
    return backwards(doublings, _CLOSED) - doublings[[RIGHT, DOWN]]


def backwards(values: np.ndarray, fill: float) -> np.ndarray:
    """Return the values [5, H, W] of the moves back from the right and from below [2, H, W]."""
    from_right = shift(values[LEFT], MOVES[RIGHT - 1], fill)
    from_below = shift(values[UP], MOVES[DOWN - 1], fill)
    return np.stack([from_right, from_below])


def _check_connected(fixed: np.ndarray, free: np.ndarray) -> None:
    """Raise InputError if one-way lanes make a cell unreachable from another."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    move, row, column = np.nonzero(fixed)
    begin = row * free.shape[1] + column
    edges = np.ones(len(begin)), (begin, begin + move_steps(free.shape[1])[move])
    _, label = connected_components(coo_array(edges, shape=(free.size,) * 2), connection="strong")
    labels = label[free.reshape(-1)]
    if (labels != labels[0]).any():
        cell = np.flatnonzero(free.reshape(-1))[np.argmax(labels != labels[0])]
        place = "row {}, column {}".format(*divmod(cell, free.shape[1]))
        raise InputError(f"one-way lanes cut off {place}: give a way there and a way back")


def crisscross(traversable: np.ndarray, width: int = 1) -> np.ndarray:
    """Halve the cost of one direction, alternately, in rows and in columns (as published).

    To the right in even lanes, to the left in odd ones; up in even columns, down in odd ones. Lanes
    are `width` rows or columns wide: with two, aisles alternate also where every other row is one.
    """
    costs = np.ones((NUM_MOVES, *traversable.shape))
    rows, cols = (np.arange(size) // width % 2 == 0 for size in traversable.shape)
    costs[RIGHT, rows] = costs[LEFT, ~rows] = costs[UP, :, cols] = costs[DOWN, :, ~cols] = 0.5
    return costs


# Each makes the costs of a floor: (traversable bool [H, W], for each kind of task the odds of each
# cell to be its start and its end, float [L, 2, H, W]) -> float [5, H, W], or None for no guidance.
GUIDANCE: dict[str, Callable[[np.ndarray, np.ndarray], np.ndarray | None]] = {
    "none": lambda traversable, legs: None,
    "crisscross": lambda traversable, legs: crisscross(traversable),
    "crisscross-pairs": lambda traversable, legs: crisscross(
        traversable, _WIDTHS["crisscross-pairs"]
    ),
    # Late: these import a compiler.
    "traffic-flow": lambda *floor: pkgutil.resolve_name("qdenv.highways:traffic_flow")(*floor),
    "human-cost": lambda *floor: pkgutil.resolve_name("qdenv.highways:human_cost")(*floor),
}
