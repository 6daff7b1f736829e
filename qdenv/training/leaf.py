"""One array of a checkpoint: those of its rows that hold anything, and which they are."""

from pathlib import Path

import numpy as np

from qdenv.io.files import damaged
from qdenv.types import InputError


def another(source: Path) -> InputError:
    """Make the error for a checkpoint whose arrays have other forms than this search's."""
    return InputError(f"{source}: belongs to another configuration")


def check_leaf(
    rows: np.ndarray | None, held: np.ndarray | None, like: np.ndarray, source: Path
) -> np.ndarray:
    """Refuse stored rows that are none of an array.

    Args:
        rows: as stored; None where they are missing.
        held: which rows of the array they are; None for an array without axes.
        like: the array of a search that begins; it may have another length.
        source: the file.

    Returns:
        `rows`.

    Raises:
        DamagedError: something is missing, or the parts contradict each other.
        InputError: they are of another configuration.
    """
    if rows is None or (held is None) != (like.ndim == 0):
        raise damaged(source, "an array is missing")
    if rows.dtype != like.dtype or rows.shape[1:] != like.shape[1:] or rows.ndim != like.ndim:
        raise another(source)
    if held is not None and (held.shape != (len(rows),) or held.dtype.kind not in "iu"):
        raise damaged(source, "an array does not say which of its rows are held")
    return rows


def filled(
    rows: np.ndarray, held: np.ndarray | None, length: int, base: np.ndarray | None, source: Path
) -> np.ndarray:
    """Put checked rows back into an array.

    Args:
        rows: [n, ...].
        held: int [n]; None for an array without axes.
        length: of the array.
        base: what stands in the other rows; zeros unless given.
        source: the file.

    Raises:
        InputError: a row lies outside.
    """
    if held is None:
        return rows
    if held.size and not 0 <= held.min() <= held.max() < length:
        raise another(source)
    array = np.zeros((length, *rows.shape[1:]), rows.dtype) if base is None else base.copy()
    array[held] = rows
    return array
