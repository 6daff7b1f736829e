"""Checkpoints of schema 1: each archive held its solutions itself, unchanged rows were left out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from qdenv.lazy import jax
from qdenv.search.store import stores_in
from qdenv.training.leaf import another, check_leaf, filled

Arrays = dict[str, np.ndarray]


def upgraded(
    arrays: Arrays, leaves: int, initial: Any, bits: list[np.ndarray], source: Path
) -> tuple[Arrays, list[int]]:
    """Turn the content of a checkpoint of schema 1 into that of today.

    Args:
        arrays: ``N.rows`` and ``N.changed`` of each leaf, as they were stored.
        leaves: their number, as the checkpoint says it.
        initial: an initial state of the same search, of today.
        bits: its leaves as arrays, floats viewed as integers.
        source: the file.

    Returns:
        arrays and lengths of schema 2.

    Raises:
        InputError: the arrays are of another search, or damaged.
    """
    stores = stores_in(initial)
    plain = bits[: len(bits) - sum(len(store) for store in stores)]  # stores came last
    if leaves != len(plain):
        raise another(source)
    new: Arrays = {}
    dense = _genotypes(initial) if stores else set()
    cells, solutions = [np.zeros(1, np.int32)], [bits[-1][:1]]
    for number, base in enumerate(plain):
        held = arrays.get(f"{number}.changed")
        like = bits[-1] if number in dense and held is not None else base
        rows = check_leaf(arrays.get(f"{number}.rows"), held, like, source)
        if held is None:
            new[f"{number}.rows"] = rows
            continue
        if number in dense:
            # Solutions move to the store, one after the other; their cells refer to them.
            first = sum(map(len, cells))
            cells.append(held)
            solutions.append(rows)
            rows = np.arange(first, first + len(rows), dtype=np.int32)
        new |= _whole(number, filled(rows, held, len(base), base, source))
    if stores:
        used = np.ones(sum(map(len, cells)), bool)
        for place, leaf in enumerate((np.concatenate(cells), used, np.concatenate(solutions))):
            new |= _whole(len(plain) + place, leaf)
    lengths = [len(new[f"{n}.rows"]) if f"{n}.changed" in new else 0 for n in range(len(bits))]
    return new, lengths


def _genotypes(state: Any) -> set[int]:
    """List the numbers of the leaves in which archives refer to solutions."""
    paths = jax.tree_util.tree_flatten_with_path(state)[0]
    return {
        number
        for number, (path, _) in enumerate(paths)
        if getattr(path[-1], "name", "") == "genotypes"
    }


def _whole(number: int, leaf: np.ndarray) -> Arrays:
    everyone = np.arange(len(leaf), dtype=np.int32)
    return {f"{number}.rows": leaf, f"{number}.changed": everyone}
