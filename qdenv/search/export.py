"""Archives as tables and files: pandas with pyribs' column names, CSV and npz."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from qdenv.files import write_atomically
from qdenv.search.archive import GridArchive
from qdenv.types import InputError, Measure


def elites(archive: GridArchive) -> dict[str, np.ndarray]:
    """Collect the filled cells as numpy arrays with a leading axis of elites.

    Returns:
        pyribs' fields ``solution, objective, measures, threshold, index`` (the threshold of an
        elitist archive is the objective) and one more for every extra.

    Raises:
        InputError: the solutions are no single array [C, P], or an extra takes a field's name.
    """
    if not hasattr(archive.genotypes, "shape"):
        raise InputError("only an archive whose solutions are one array [C, P] can be exported")
    index = np.flatnonzero(np.asarray(archive.filled))
    thresholds = getattr(archive, "thresholds", archive.objectives)
    fields = {
        "solution": archive.genotypes,
        "objective": archive.objectives,
        "measures": archive.descriptors,
        "threshold": thresholds,
    }
    taken = (fields.keys() | {"index"}) & archive.extra_scores.keys()
    if taken:
        raise InputError(f"rename the extra {sorted(taken)[0]!r}: an archive has that field")
    rows = {name: np.asarray(values)[index] for name, values in fields.items()}
    extras = {name: np.asarray(archive.extra_scores[name])[index] for name in archive.extra_scores}
    return {**rows, **extras, "index": index.astype(np.int32)}


def to_pandas(archive: GridArchive, fields: Sequence[str] | None = None) -> Any:
    """Make a pandas data frame with one row per elite and pyribs' column names.

    pyribs' ``ribs.visualize`` functions accept it as their ``df``.

    Args:
        archive: the archive.
        fields: which fields of `elites`; by default all that hold at most one axis per elite
            (a table has no place for whole layouts).

    Raises:
        InputError: pandas is not installed, or a field does not exist or has more axes.
    """
    try:
        import pandas
    except ImportError as error:
        raise InputError("tables need pandas: pip install 'qdenv[data]'") from error
    rows = elites(archive)
    if fields is None:
        fields = [name for name, values in rows.items() if values.ndim <= 2]
    columns: dict[str, np.ndarray] = {}
    for name in fields:
        if name not in rows or rows[name].ndim > 2:
            raise InputError(f"{name!r} is no column of this archive; it has {', '.join(rows)}")
        values = rows[name]
        if values.ndim == 1:
            columns[name] = values
        else:
            columns |= {f"{name}_{i}": values[:, i] for i in range(values.shape[1])}
    return pandas.DataFrame(columns)


def save_csv(archive: GridArchive, path: str | os.PathLike) -> None:
    """Write `to_pandas` of the archive as CSV, atomically."""
    write_atomically(Path(path), to_pandas(archive).to_csv(index=False).encode())


def save_npz(archive: GridArchive, path: str | os.PathLike) -> None:
    """Write the filled cells and the axes as npz, atomically; `load_npz` reads it back.

    The file holds the fields of `elites` and ``measure_names, measure_lows, measure_highs,
    measure_cells``.
    """
    axes = archive.measures
    grid = {
        "measure_names": np.array([axis.name for axis in axes]),
        "measure_lows": np.array([axis.low for axis in axes]),
        "measure_highs": np.array([axis.high for axis in axes]),
        "measure_cells": np.array([axis.cells for axis in axes]),
    }
    rows = elites(archive)
    write_atomically(Path(path), lambda file: np.savez_compressed(file, **rows, **grid))


def load_npz(path: str | os.PathLike) -> GridArchive:
    """Read what `save_npz` wrote into an elitist archive with the same cells.

    Raises:
        InputError: the file is missing or no archive.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            rows = dict(file)
        grid = [rows.pop(f"measure_{part}") for part in ("names", "lows", "highs", "cells")]
        measures = [
            Measure(str(name), float(low), float(high), int(cells))
            for name, low, high, cells in zip(*grid, strict=True)
        ]
        index = rows.pop("index")
        solution, objective = rows.pop("solution"), rows.pop("objective")
        places = rows.pop("measures")
    except (OSError, ValueError, KeyError, EOFError) as error:
        raise InputError(f"{path} is no saved archive ({error})") from error
    rows.pop("threshold", None)
    blank = GridArchive.empty(
        jax.ShapeDtypeStruct(solution.shape[1:], solution.dtype),
        measures,
        {name: jax.ShapeDtypeStruct(rows[name].shape[1:], rows[name].dtype) for name in rows},
    )
    return blank.replace(
        genotypes=blank.genotypes.at[index].set(solution),
        fitnesses=blank.fitnesses.at[index, 0].set(objective),
        descriptors=blank.descriptors.at[index].set(places),
        extra_scores={
            name: blank.extra_scores[name].at[index].set(values) for name, values in rows.items()
        },
    )
