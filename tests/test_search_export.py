"""Archives as tables and files."""

import json

import numpy as np
import pytest
from matplotlib import pyplot

from qdenv.search.archive import GridArchive
from qdenv.search.export import elites, load_npz, save_csv, save_npz, to_pandas
from qdenv.types import InputError, Measure

pandas = pytest.importorskip("pandas")
GRID = (Measure("x", 0, 4, 4), Measure("y", 0, 3, 3))
# What ribs 0.12 gives for archive.data(return_type="pandas") with these extra fields.
COLUMNS = ["solution_0", "solution_1", "objective", "measures_0", "measures_1", "threshold"]
COLUMNS += ["similarity", "runs_0", "runs_1", "index"]


def example(kind=GridArchive, **settings):
    extras = {
        "similarity": np.zeros((), np.float32),
        "runs": np.zeros(2, np.float32),
        "tiles": np.zeros((2, 3), np.int8),
    }
    archive = kind.empty(np.zeros(2, np.float32), GRID, extras, **settings)
    rows = {
        "similarity": np.array([0.5, 0.75, 1], np.float32),
        "runs": np.arange(6, dtype=np.float32).reshape(3, 2),
        "tiles": np.arange(18, dtype=np.int8).reshape(3, 2, 3),
    }
    solutions = np.array([[1, 2], [3, 4], [5, 6]], np.float32)
    measures = np.array([[0.5, 0.5], [1.5, 2.5], [3.5, 1.5]], np.float32)
    return archive.insert(solutions, np.array([3.0, 1.0, 2.0]), measures, rows)[0]


def test_the_table_has_pyribs_columns_and_one_row_per_elite():
    frame = to_pandas(example())
    assert set(frame.columns) == set(COLUMNS) and list(frame.columns)[:6] == COLUMNS[:6]
    assert frame["index"].tolist() == [0, 5, 10]
    assert frame["objective"].tolist() == [3, 1, 2] == frame["threshold"].tolist()
    assert frame["solution_1"].tolist() == [2, 4, 6]
    assert frame["runs_1"].tolist() == [1, 3, 5]
    soft = to_pandas(example(GridArchive, learning_rate=0.5, threshold_min=0.0))
    assert soft["threshold"].tolist() == [1.5, 0.5, 1]
    assert list(to_pandas(example(), ["objective"]).columns) == ["objective"]
    with pytest.raises(InputError, match="tiles"):
        to_pandas(example(), ["tiles"])


def test_pyribs_draws_the_table():
    visualize = pytest.importorskip("ribs.visualize", reason="needs pip install 'qdenv[pyribs]'")
    ribs = pytest.importorskip("ribs.archives")
    pyplot.switch_backend("Agg")
    grid = ribs.GridArchive(solution_dim=2, dims=[4, 3], ranges=[(0, 4), (0, 3)])
    figure, axes = pyplot.subplots()
    visualize.grid_archive_heatmap(grid, axes, df=ribs.ArchiveDataFrame(to_pandas(example())))
    colours = np.asarray(axes.collections[0].get_array())
    assert np.nansum(colours) == 6
    pyplot.close(figure)


def test_csv_reads_back(tmp_path):
    save_csv(example(), tmp_path / "archive.csv")
    frame = pandas.read_csv(tmp_path / "archive.csv")
    pandas.testing.assert_frame_equal(frame, to_pandas(example()), check_dtype=False)


def test_npz_reads_back_to_the_same_archive(tmp_path):
    archive = example()
    save_npz(archive, tmp_path / "archive.npz")
    again = load_npz(tmp_path / "archive.npz")
    assert again.measures == archive.measures
    for name, values in elites(archive).items():
        np.testing.assert_array_equal(values, elites(again)[name])
        assert values.dtype == elites(again)[name].dtype
    np.testing.assert_array_equal(again.fitnesses, archive.fitnesses)
    assert [path.name for path in tmp_path.iterdir()] == ["archive.npz"]


def test_a_runs_archive_reads_back_with_the_measures_of_its_run(tmp_path):
    # What `train` leaves: the columns without the axes, which are in the run's manifest.
    archive = example()
    np.savez_compressed(tmp_path / "archive.npz", **elites(archive))
    again = load_npz(tmp_path / "archive.npz", GRID)
    np.testing.assert_array_equal(again.fitnesses, archive.fitnesses)
    np.testing.assert_array_equal(again.extra_scores["tiles"], archive.extra_scores["tiles"])
    with pytest.raises(InputError, match="hand them in"):
        load_npz(tmp_path / "archive.npz")
    for wrong in (GRID[:1], (Measure("x", 0, 4, 2), GRID[1])):
        with pytest.raises(InputError, match="other measures"):
            load_npz(tmp_path / "archive.npz", wrong)


def test_a_runs_archive_finds_its_axes_in_the_manifest_beside_it(tmp_path):
    archive = example()
    np.savez_compressed(tmp_path / "archive.npz", **elites(archive))
    axes = [{"name": m.name, "low": m.low, "high": m.high, "cells": m.cells} for m in GRID]
    (tmp_path / "manifest.json").write_text(json.dumps({"schema": 2, "measures": axes}))
    again = load_npz(tmp_path / "archive.npz")
    assert again.measures == archive.measures
    np.testing.assert_array_equal(again.fitnesses, archive.fitnesses)
    for content in ("", "[]", '{"measures": 3}', '{"measures": [{"nom": 1}]}'):
        (tmp_path / "manifest.json").write_text(content)
        with pytest.raises(InputError, match="cannot be read"):
            load_npz(tmp_path / "archive.npz")


def test_columns_of_a_run_and_of_a_soft_archive():
    rows = elites(example())
    columns = ["index", "solution", "objective", "measures"]
    assert list(rows) == [*columns, "runs", "similarity", "tiles"]
    assert rows["index"].tolist() == [0, 5, 10]
    soft = elites(example(GridArchive, learning_rate=0.5, threshold_min=0.0))
    assert soft["threshold"].tolist() == [1.5, 0.5, 1]


def test_an_empty_archive_is_an_empty_table(tmp_path):
    empty = GridArchive.empty(np.zeros(2, np.float32), GRID)
    assert len(to_pandas(empty)) == 0
    save_npz(empty, tmp_path / "empty.npz")
    assert not load_npz(tmp_path / "empty.npz").filled.any()


def test_what_is_no_archive_gives_one_clear_line(tmp_path):
    for name, content in (("text.npz", b"hello"), ("empty.npz", b"")):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match="cannot be read"):
            load_npz(tmp_path / name)
    np.savez(tmp_path / "other.npz", a=1)
    for name in ("other.npz", "missing.npz"):
        with pytest.raises(InputError, match="cannot be read"):
            load_npz(tmp_path / name)
    clash = GridArchive.empty(np.zeros(2), GRID, {"index": np.zeros(())})
    with pytest.raises(InputError, match="index"):
        elites(clash)
