"""Archives as tables and files: one column layout for npz, CSV and pandas (pyribs' names)."""

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import numpy as np

from qdenv.io.arrays import Column, read_arrays, write_arrays
from qdenv.io.files import damaged, write_atomically
from qdenv.io.records import read_json
from qdenv.search.archive import GridArchive
from qdenv.search.axes import Axis, axes_of
from qdenv.search.base import Algorithm
from qdenv.types import InputError, Measure

if TYPE_CHECKING:
    import pandas

_TAKEN_AT_ONCE = 1024  # elites
# What a saved archive must hold.
_SAVED = {
    "index": Column("iu", 1),
    "solution": Column("iuf", 2),
    "objective": Column("iuf", 1),
    "measures": Column("iuf", 2),
}


class _Axes(NamedTuple):
    """The part of a manifest that says what an archive is over."""

    measures: list[Axis]


def elites(archive: GridArchive) -> dict[str, np.ndarray]:
    """Collect the filled cells as numpy arrays with a leading axis of elites.

    Returns:
        ``index`` (int64, the cells), ``solution``, ``objective``, ``measures``, for a soft archive
        ``threshold``, and one more column for every extra. A run's archive.npz holds these names.

    Raises:
        InputError: the solutions are no single array [C, P], or an extra takes a column's name.
    """
    index = np.flatnonzero(np.asarray(archive.filled))
    columns = _columns(archive)
    return {"index": index} | {name: np.asarray(column)[index] for name, column in columns.items()}


def _columns(archive: GridArchive) -> dict[str, jax.Array]:
    if not hasattr(archive.genotypes, "shape"):
        raise InputError("only an archive whose solutions are one array [C, P] can be exported")
    columns = {
        "solution": archive.genotypes,
        "objective": archive.objectives,
        "measures": archive.descriptors,
    }
    if archive.thresholds is not None:
        columns["threshold"] = archive.thresholds
    taken = {*columns, "index", "threshold"} & archive.extra_scores.keys()
    if taken:
        raise InputError(f"rename the extra {sorted(taken)[0]!r}: an archive has that field")
    return {**columns, **archive.extra_scores}


def collector(algorithm: Algorithm) -> Callable[[Any], dict[str, np.ndarray]]:
    """Make the function state -> `elites` of the result archive, for searches large and running.

    On the way no archive is made that holds a solution for every cell.
    """

    @jax.jit
    def filled(state: Any) -> jax.Array:
        return algorithm.archive(state).filled

    @jax.jit
    def take(state: Any, cells: jax.Array) -> dict[str, jax.Array]:
        # XLA fuses both look-ups, the cell's row and the row's solution, into one.
        return _columns(jax.tree.map(lambda leaf: leaf[cells], algorithm.archive(state)))

    def collect(state: Any) -> dict[str, np.ndarray]:
        index = np.flatnonzero(filled(state))
        columns = {
            name: np.empty((len(index), *column.shape[1:]), column.dtype)
            for name, column in jax.eval_shape(take, state, index).items()
        }
        for start in range(0, len(index), _TAKEN_AT_ONCE):
            part = index[start : start + _TAKEN_AT_ONCE]
            cells = np.zeros(_TAKEN_AT_ONCE, np.int32)  # filled up to the shape that is compiled
            cells[: len(part)] = part
            for name, column in take(state, cells).items():
                columns[name][start : start + len(part)] = np.asarray(column)[: len(part)]
        return {"index": index} | columns

    return collect


def to_pandas(archive: GridArchive, fields: Sequence[str] | None = None) -> "pandas.DataFrame":
    """Make a pandas data frame with one row per elite and pyribs' column names.

    pyribs' ``ribs.visualize`` functions accept it as their ``df``.

    Args:
        archive: the archive.
        fields: which columns of `elites` or ``threshold`` (of an elitist archive the objective);
            by default all with at most one axis per elite (a table has no place for whole
            layouts).

    Raises:
        InputError: pandas is not installed, or a field does not exist or has more axes.
    """
    try:
        import pandas
    except ImportError as error:
        raise InputError("tables need pandas: pip install 'qdenv[data]'") from error
    rows = elites(archive)
    rows = {"threshold": rows["objective"]} | rows
    if fields is None:
        first = ("solution", "objective", "measures", "threshold")
        order = dict.fromkeys((*first, *(name for name in rows if name != "index"), "index"))
        fields = [name for name in order if rows[name].ndim <= 2]
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

    The file holds the columns of `elites` and ``measure_names, measure_lows, measure_highs,
    measure_cells``.
    """
    axes = archive.measures
    grid = {
        "measure_names": np.array([axis.name for axis in axes]),
        "measure_lows": np.array([axis.low for axis in axes]),
        "measure_highs": np.array([axis.high for axis in axes]),
        "measure_cells": np.array([axis.cells for axis in axes]),
    }
    write_arrays(Path(path), {**elites(archive), **grid}, compressed=True)


def load_npz(path: str | os.PathLike, measures: Sequence[Measure] | None = None) -> GridArchive:
    """Read a saved archive into an elitist archive with the same cells.

    Args:
        path: a file of `save_npz`, or the archive.npz of a run.
        measures: the axes; the archive of a run finds them in the manifest.json beside it.

    Raises:
        InputError: the file is missing, no archive, or has no axes and none were given.
    """
    path = Path(path)
    rows = read_arrays(path, _SAVED)
    index, solution = rows.pop("index"), rows.pop("solution")
    objective, places = rows.pop("objective"), rows.pop("measures")
    stored = _pop_axes(rows, path) or _axes_of_run(path.with_name("manifest.json"))
    axes = measures or stored
    if not axes:
        raise InputError(
            f"{path} does not hold its axes: hand them in, load_npz(path, measures) with the "
            "measures of its RunDirectory"
        )
    rows.pop("threshold", None)  # what is read back is elitist
    blank = GridArchive.empty(
        jax.ShapeDtypeStruct(solution.shape[1:], solution.dtype),
        axes,
        {name: jax.ShapeDtypeStruct(rows[name].shape[1:], rows[name].dtype) for name in rows},
    )
    inside = 0 <= index.min(initial=0) <= index.max(initial=0) < len(blank.fitnesses)
    alike = all(len(values) == len(index) for values in (solution, objective, places))
    if places.shape[1:] != (len(axes),) or not (inside and alike):
        raise InputError(f"{path} is an archive over other measures: hand in those of its run")
    return blank.replace(
        genotypes=blank.genotypes.at[index].set(solution),
        fitnesses=blank.fitnesses.at[index, 0].set(objective),
        descriptors=blank.descriptors.at[index].set(places),
        extra_scores={
            name: blank.extra_scores[name].at[index].set(values) for name, values in rows.items()
        },
    )


def _axes_of_run(manifest: Path) -> tuple[Measure, ...]:
    """Read the axes of a run's archive, which its manifest holds; none where there is no such."""
    return axes_of(read_json(manifest, _Axes).measures, manifest) if manifest.exists() else ()


def _pop_axes(rows: dict[str, np.ndarray], source: Path) -> tuple[Measure, ...]:
    """Take the axes out of the arrays of a file; none where it has none."""
    parts = ("names", "lows", "highs", "cells")
    grid = [rows.pop(f"measure_{part}", np.empty(0)) for part in parts]
    if len({column.shape for column in grid}) > 1 or grid[0].ndim != 1:
        raise damaged(source, "its axes are incomplete")
    columns = [column.tolist() for column in grid]
    return axes_of(list(map(Axis, *columns)), source) if columns[0] else ()
