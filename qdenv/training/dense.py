"""Checkpoints of schema 1: each archive held its solutions itself, unchanged rows were left out."""

from __future__ import annotations

from typing import Any

import numpy as np

from qdenv.lazy import jax
from qdenv.search.store import stores_in

Arrays = dict[str, np.ndarray]


def upgraded(
    arrays: Arrays, manifest: dict[str, Any], initial: Any, bits: list[np.ndarray]
) -> tuple[Arrays, dict[str, Any]]:
    """Turn the content of a checkpoint of schema 1 into that of today.

    Args:
        arrays: ``N.rows`` and ``N.changed`` of each leaf, as they were stored.
        manifest: the facts; ``leaves`` is their number.
        initial: an initial state of the same search, of today.
        bits: its leaves as arrays, floats viewed as integers.

    Returns:
        arrays and manifest of schema 2. They do not fit `initial` where they are of another search.
    """
    stores = stores_in(initial)
    plain = bits[: len(bits) - sum(len(store) for store in stores)]  # stores came last
    if manifest["leaves"] != len(plain):
        return arrays, manifest | {"lengths": []}
    new: Arrays = {}
    dense = _genotypes(initial) if stores else set()
    cells, solutions = [np.zeros(1, np.int32)], [bits[-1][:1]]
    for number, base in enumerate(plain):
        rows, changed = arrays[f"{number}.rows"], arrays.get(f"{number}.changed")
        if changed is None:
            new[f"{number}.rows"] = rows
            continue
        if number in dense:
            # Solutions move to the store, one after the other; their cells refer to them.
            first = sum(map(len, cells))
            cells.append(changed)
            solutions.append(rows)
            rows = np.arange(first, first + len(rows), dtype=np.int32)
        leaf = base.copy()
        leaf[changed] = rows
        new |= _whole(number, leaf)
    if stores:
        used = np.ones(sum(map(len, cells)), bool)
        for place, leaf in enumerate((np.concatenate(cells), used, np.concatenate(solutions))):
            new |= _whole(len(plain) + place, leaf)
    lengths = [len(new[f"{n}.rows"]) if f"{n}.changed" in new else 0 for n in range(len(bits))]
    return new, manifest | {"lengths": lengths}


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
