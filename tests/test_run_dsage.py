"""Searches of tiles end to end: DSAGE and screening on a toy domain, interrupted and not."""

import dataclasses

import numpy as np
import pytest
import toy

from qdenv.run.config import choose_algorithm
from qdenv.run.directory import NOTES, RunDirectory
from qdenv.run.loop import resume, train
from qdenv.search.settings import CmaEsConfig, DsageConfig, ScreenedConfig
from qdenv.study.elites import grow_elite
from qdenv.surrogates.settings import SurrogateConfig
from qdenv.types import InputError

pytestmark = pytest.mark.slow

TINY = SurrogateConfig(channels=4, blocks=1, epochs=2, minibatch=8, samples=64)
DSAGE = DsageConfig(
    batch=8, initial=16, inner_iterations=10, inner_batch=8, downsample=(4, 3), surrogate=TINY
)
SCREENED = ScreenedConfig(emitters=2, batch=4, sigma0=0.5, screen=3, refit=2, surrogate=TINY)
SEARCHES = {
    "dsage": choose_algorithm(toy.CONFIG, DSAGE),
    "cma-mae-screened": choose_algorithm(toy.CONFIG, SCREENED),
}


@pytest.mark.parametrize("name", SEARCHES)
def test_a_resumed_search_with_a_surrogate_equals_an_uninterrupted_one(name, tmp_path):
    config = dataclasses.replace(SEARCHES[name], evaluations=40)
    whole = train(config, tmp_path / "whole", progress=False)
    half = dataclasses.replace(config, evaluations=24)
    train(half, tmp_path / "half", progress=False)
    again = resume(tmp_path / "half", progress=False, evaluations=40)
    expected, found = whole.archive.columns, again.archive.columns
    assert expected.keys() == found.keys() and len(expected["index"]) > 3
    for column in expected:
        np.testing.assert_array_equal(found[column], expected[column])
    said = (whole.path / NOTES).read_bytes()
    assert (again.path / NOTES).read_bytes() == said and said.count(b"\n") == 6


def test_notes_are_blank_until_the_surrogate_has_learnt(tmp_path):
    run = train(dataclasses.replace(SEARCHES["dsage"], evaluations=32), tmp_path, progress=False)
    notes = run.read_notes()
    assert [note["evaluations"] for note in notes] == [8, 16, 24, 32]
    assert np.isnan([note["rmse_paths"] for note in notes]).tolist() == [True, True, False, False]
    assert notes[-1]["loss_repair"] > 0 and 0 <= notes[-1]["tiles_right"] <= 1
    assert "loss_usage" not in notes[0]  # a stroll leaves no map of usage


@pytest.mark.parametrize(
    "damage", [b"iteration\n1,2,3\n", b"a,b\n1,2\n", b"\xff\xfe", b"iteration\nx\n"]
)
def test_damaged_notes_are_one_line_and_stop_no_run(damage, tmp_path, caplog):
    (tmp_path / NOTES).write_bytes(damage)
    with pytest.raises(InputError, match=r"notes\.csv: cannot be read"):
        RunDirectory(tmp_path).read_notes()
    assert RunDirectory(tmp_path).read_notes(salvage=True) == []
    assert "what follows row 0 is lost" in caplog.text


def test_elites_of_dsage_are_the_tiles_that_were_evaluated(tmp_path):
    run = train(dataclasses.replace(SEARCHES["dsage"], evaluations=32), tmp_path, progress=False)
    archive = run.archive.columns
    assert set(np.unique(archive["solution"])) <= {0.0, 1.0, 2.0}
    drawn = archive["solution"].reshape(-1, 5, 6)
    np.testing.assert_array_equal(archive["unrepaired"], drawn)
    grown = grow_elite(run, run.best, (None, None))
    np.testing.assert_array_equal(grown.layout, run.best.solution.reshape(5, 6))
    with pytest.raises(InputError, match="searched tiles"):
        grow_elite(run, run.best, (7, 8))


def test_the_generator_follows_the_algorithm_and_back():
    tiles = choose_algorithm(toy.CONFIG, "dsage")
    assert type(tiles.evaluation.generator).__name__ == "DirectConfig"
    back = choose_algorithm(tiles, CmaEsConfig())
    assert type(back.evaluation.generator).__name__ == "NcaConfig"
    kept = choose_algorithm(toy.CONFIG, CmaEsConfig())
    assert kept.evaluation.generator == toy.CONFIG.evaluation.generator


def test_dsage_refuses_solutions_that_are_no_tiles(tmp_path):
    config = dataclasses.replace(toy.CONFIG, algorithm=DSAGE)
    with pytest.raises(InputError, match="generator is direct"):
        train(config, tmp_path / "run", progress=False)
    assert not (tmp_path / "run").exists()
