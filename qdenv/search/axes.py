"""The axes of a grid archive: from measures to cells."""

import functools
import math
from collections.abc import Sequence

import numpy as np

from qdenv.types import InputError, Measure

_MOST_CELLS = 1_000_000  # each holds two layouts: of size S 2.4 GB in all
_MOST_AXES = 16  # numpy has 64, and the number of cells must be printable
_EDGE_TOLERANCE = 1e-6  # pyribs' epsilon: a measure this little below an edge is above it


def check_measures(measures: Sequence[Measure]) -> tuple[Measure, ...]:
    """Reduce measures to their axes, which are compared and hashed as static fields of an archive.

    Raises InputError if there is no measure, a range is empty or infinite, an axis has no cell, or
    there are too many in all.
    """
    if not measures:
        raise InputError("an archive needs at least one measure")
    axes = tuple(Measure(str(m.name), float(m.low), float(m.high), int(m.cells)) for m in measures)
    for axis in axes:
        # False for NaN as well.
        if not (-math.inf < axis.low < axis.high < math.inf and axis.cells >= 1):
            empty = f"{axis.low:g} to {axis.high:g} in {axis.cells} cells is empty"
            raise InputError(f"axis {axis.name!r}: {empty}: give LOW < HIGH and at least one cell")
    if len(axes) > _MOST_AXES:
        raise InputError(f"an archive of {len(axes)} measures: give {_MOST_AXES} at most")
    if (cells := math.prod(axis.cells for axis in axes)) > _MOST_CELLS:
        raise InputError(f"an archive of {cells:,} cells: give {_MOST_CELLS:,} at most")
    return axes


@functools.lru_cache
def inner_edges(axis: Measure, dtype: np.dtype) -> np.ndarray:
    """List the edges between the cells of an axis, ``[cells - 1]`` ascending values of `dtype`.

    A measure lies in the cell given by the number of inner edges at or below it. This is pyribs'
    ``floor((cells * (m - low) + 1e-6) / (high - low))`` clipped to the grid, but free of the
    roundings of that formula in float32: integers on an edge always fall above it.
    """
    numerators = np.arange(1, axis.cells) * (axis.high - axis.low) - _EDGE_TOLERANCE
    exact = axis.low + numerators / axis.cells
    edges = exact.astype(dtype)
    # Rounded up, so that comparing in `dtype` decides as comparing in float64 would.
    return np.where(edges < exact, np.nextafter(edges, dtype.type(np.inf)), edges)
