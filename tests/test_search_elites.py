"""An archive as columns of its elites, as tables, and back."""

import numpy as np
import pytest

from qdenv.run.archive import ArchiveSchema, SavedArchive
from qdenv.search.archive import GridArchive
from qdenv.types import InputError, Measure

pandas = pytest.importorskip("pandas")
GRID = (Measure("x", 0, 4, 4), Measure("y", 0, 3, 3))


def example(*rates):
    extras = {
        "similarity": np.zeros((), np.float32),
        "runs": np.zeros(2, np.float32),
        "tiles": np.zeros((2, 3), np.int8),
    }
    archive = GridArchive.empty(np.zeros(2, np.float32), GRID, extras, *rates)
    rows = {
        "similarity": np.array([0.5, 0.75, 1], np.float32),
        "runs": np.arange(6, dtype=np.float32).reshape(3, 2),
        "tiles": np.arange(18, dtype=np.int8).reshape(3, 2, 3),
    }
    solutions = np.array([[1, 2], [3, 4], [5, 6]], np.float32)
    measures = np.array([[0.5, 0.5], [1.5, 2.5], [3.5, 1.5]], np.float32)
    return archive.insert(solutions, np.array([3.0, 1.0, 2.0]), measures, rows)[0]


def saved(archive):
    return SavedArchive(archive.elites(), ArchiveSchema(GRID, "", {}), "a search of one's own")


def test_columns_of_an_elitist_and_of_a_soft_archive():
    rows = example().elites()
    columns = ["index", "solution", "objective", "measures"]
    assert list(rows) == [*columns, "runs", "similarity", "tiles"]
    assert rows["index"].tolist() == [0, 5, 10]
    assert example(0.5, 0.0).elites()["threshold"].tolist() == [1.5, 0.5, 1]
    clash = GridArchive.empty(np.zeros(2), GRID, {"index": np.zeros(())})
    with pytest.raises(InputError, match="index"):
        clash.elites()
    with pytest.raises(InputError, match="one array"):
        GridArchive.empty({"a": np.zeros(2)}, GRID).elites()


@pytest.mark.slow
def test_a_search_without_a_run_is_a_table_and_an_archive_of_pyribs(tmp_path):
    archive = saved(example())
    assert repr(archive) == "SavedArchive(3 elites, coverage 25.0%, QD-score 6, best 3)"
    archive.write_table(tmp_path / "archive.csv", solutions=True)
    frame = pandas.read_csv(tmp_path / "archive.csv")
    pandas.testing.assert_frame_equal(frame, archive.to_pandas(solutions=True), check_dtype=False)
    assert frame["cell"].tolist() == ["0,0", "1,2", "3,1"]
    assert frame["objective"].tolist() == [3, 1, 2] and frame["x"].tolist() == [0.5, 1.5, 3.5]
    assert frame["solution_1"].tolist() == [2, 4, 6] and frame["runs_1"].tolist() == [1, 3, 5]
    assert len(saved(GridArchive.empty(np.zeros(2, np.float32), GRID)).to_pandas()) == 0
    pytest.importorskip("ribs.archives", reason="needs pip install 'qdenv[pyribs]'")
    theirs = archive.to_ribs(["runs"]).data(return_type="dict")
    assert theirs["index"].tolist() == [0, 5, 10] and theirs["objective"].tolist() == [3, 1, 2]
    assert theirs["runs"].tolist() == [[0, 1], [2, 3], [4, 5]]
