"""The loop: jitted and pipelined agree, nothing is traced twice, a kill loses nothing."""

import os
import signal
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import jax
import numpy as np
import pytest
import toy

from qdenv.pipeline import PipelinedEvaluator, evaluate, make_pipeline
from qdenv.train import loop
from qdenv.train.records import RunDirectory
from qdenv.types import InputError, RepairStatus

HERE = Path(__file__).parent


def same(left: dict, right: dict) -> bool:
    """Compare dictionaries of arrays bit for bit."""
    return left.keys() == right.keys() and all(
        left[name].tobytes() == right[name].tobytes() for name in left
    )


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> RunDirectory:
    path = tmp_path_factory.mktemp("run") / "whole"
    return loop.train(toy.CONFIG, path, toy.GARDEN, progress=False)


def test_jitted_scan_and_pipelined_loop_give_the_same_archive(finished):
    traces = []

    def counted(config):
        simulator = toy.GARDEN.simulator(config)
        return simulator._replace(run=lambda *given: traces.append(1) or simulator.run(*given))

    study = loop.make_study(toy.CONFIG, replace(toy.GARDEN, simulator=counted))
    state = study.algorithm.init(study.search_key)
    iterate = loop.make_iteration(study)
    before = len(traces)
    whole = jax.jit(
        lambda state: jax.lax.scan(lambda s, i: (iterate(s, i), None), state, np.arange(1, 7))[0]
    )
    state = whole(state)
    whole(state)
    assert len(traces) == before + 1
    assert same(loop.elites(study.algorithm, state), finished.load_archive())

    evaluator = PipelinedEvaluator(study.pipeline)
    before = len(traces)
    for number in range(3):
        solutions, state = study.algorithm.ask(state)
        evaluator(solutions, jax.random.key(number))
    assert len(traces) == before + 1


def test_an_evaluation_does_not_depend_on_its_batch():
    study = loop.make_study(toy.CONFIG, toy.GARDEN)
    parameters = jax.random.normal(jax.random.key(3), (8, study.pipeline.solution_size))
    key = jax.random.key(4)
    whole = jax.jit(lambda some: evaluate(study.pipeline, some, key))(parameters)
    part = jax.jit(lambda some: evaluate(study.pipeline, some, key))(parameters[:3])
    for left, right in zip(jax.tree.leaves(whole), jax.tree.leaves(part), strict=True):
        np.testing.assert_array_equal(np.asarray(left)[:3], right)


@pytest.mark.parametrize("lanes", [2, 5, 100])
def test_lanes_change_nothing(lanes):
    def in_lanes(config):
        return toy.GARDEN.simulator(config)._replace(lanes=lanes)

    layouts = np.random.default_rng(0).integers(0, 3, (4, 5, 6)).astype(np.int8)
    indices, key = np.arange(4), jax.random.key(5)
    seen = [
        make_pipeline(domain, toy.CONFIG.evaluation).simulate(layouts, indices, key).seen
        for domain in (toy.GARDEN, replace(toy.GARDEN, simulator=in_lanes))
    ]
    assert np.asarray(seen[0]).std() > 0
    np.testing.assert_array_equal(*seen)


def test_resumed_run_ends_at_the_same_bits(finished, tmp_path):
    config = replace(toy.CONFIG, evaluations=24)
    loop.train(config, tmp_path / "half", toy.GARDEN, progress=False)
    resumed = loop.resume(tmp_path / "half", toy.GARDEN, False, toy.CONFIG.evaluations)
    assert same(resumed.load_archive(), finished.load_archive())
    drop_seconds = [row[:-1] for row in resumed.read_metrics()]
    assert drop_seconds == [row[:-1] for row in finished.read_metrics()]


# A child process that dies by SIGKILL at the chosen place of its third iteration or checkpoint.
CHILD = """
import os, signal, sys
sys.path.insert(0, {here!r})
import toy
from qdenv import files
from qdenv.train import loop, records

def die(*args, **kwargs):
    os.kill(os.getpid(), signal.SIGKILL)

if {where!r} == "iteration":
    original, calls = loop.kept, []
    loop.kept = lambda e: (calls.append(1), original(e))[1] if len(calls) < 4 else die()
else:
    original = records.save_checkpoint
    def save(path, state, initial, manifest):
        if manifest["iteration"] < 4:
            return original(path, state, initial, manifest)
        os.replace = die  # the temporary file is written, its renaming never happens
        original(path, state, initial, manifest)
    records.save_checkpoint = save
loop.train(toy.CONFIG, {path!r}, toy.GARDEN, progress=False)
"""


@pytest.mark.parametrize("where", ["iteration", "checkpoint"])
def test_killed_run_resumes_to_the_same_bits(where, finished, tmp_path):
    path = tmp_path / "killed"
    script = CHILD.format(here=str(HERE), where=where, path=str(path))
    child = subprocess.run([sys.executable, "-c", script], capture_output=True, env=os.environ)
    assert child.returncode == -signal.SIGKILL, child.stderr.decode()
    survived = RunDirectory.open(path)
    assert 0 < len(survived.read_metrics()) < 6
    resumed = loop.resume(path, toy.GARDEN, progress=False)
    assert same(resumed.load_archive(), finished.load_archive())


def test_metrics_have_the_promised_columns_and_grow(finished):
    text = (finished.path / "metrics.csv").read_text()
    header = "iteration,evaluations,qd_score,coverage,best_objective,seconds"
    assert text.splitlines()[0] == header
    rows = finished.read_metrics()
    assert [row.evaluations for row in rows] == [8, 16, 24, 32, 40, 48]
    assert all(a.coverage <= b.coverage and a.seconds < b.seconds for a, b in pairwise(rows))


def test_archive_keeps_layouts_that_obey_the_rules(finished):
    archive = finished.load_archive()
    assert archive["unrepaired"].shape == archive["repaired"].shape == (len(archive["index"]), 5, 6)
    assert ((archive["repaired"] == 2).sum(axis=(1, 2)) == 3).all()
    np.testing.assert_allclose(archive["seen"].mean(axis=1), archive["objective"], rtol=1e-6)
    agree = (archive["unrepaired"] == archive["repaired"]).mean(axis=(1, 2))
    np.testing.assert_allclose(archive["similarity"], agree, rtol=1e-6)


def test_config_returns_from_json(finished):
    assert RunDirectory.open(finished.path).config == toy.CONFIG


def test_failed_evaluations_enter_nothing():
    # 30 cells cannot hold 40 hedges: every repair says so, and the archive stays empty.
    config = replace(toy.CONFIG, evaluation=replace(toy.CONFIG.evaluation, shelves=40))
    study = loop.make_study(config, toy.GARDEN)
    state = study.algorithm.init(study.search_key)
    solutions, state = study.algorithm.ask(state)
    evaluation = PipelinedEvaluator(study.pipeline)(solutions, jax.random.key(0))
    assert (np.asarray(evaluation.status) == RepairStatus.IMPOSSIBLE).all()
    assert not np.asarray(evaluation.score.success).any()
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(evaluation.score))
    state = study.algorithm.tell(state, solutions, evaluation.score, loop.kept(evaluation))
    assert len(loop.elites(study.algorithm, state)["index"]) == 0


def test_a_run_is_never_overwritten_and_a_newer_one_not_opened(finished, tmp_path):
    with pytest.raises(InputError, match="holds a run already"):
        loop.train(toy.CONFIG, finished.path, toy.GARDEN, progress=False)
    with pytest.raises(InputError, match="no run here"):
        RunDirectory.open(tmp_path)
    (tmp_path / "config.json").write_text("{}")
    (tmp_path / "manifest.json").write_text('{"schema": 99}')
    with pytest.raises(InputError, match="newer"):
        RunDirectory.open(tmp_path)


def test_a_full_disk_keeps_what_was_written(finished, tmp_path, monkeypatch):
    config = replace(toy.CONFIG, evaluations=16)
    run = loop.train(config, tmp_path / "run", toy.GARDEN, progress=False)
    before = {path: path.read_bytes() for path in run.path.rglob("*") if path.is_file()}

    def full(handle: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(InputError, match="No space left on device"):
        loop.resume(run.path, toy.GARDEN, progress=False, evaluations=48)
    monkeypatch.undo()
    assert before == {path: path.read_bytes() for path in run.path.rglob("*") if path.is_file()}
    resumed = loop.resume(run.path, toy.GARDEN, progress=False, evaluations=48)
    assert same(resumed.load_archive(), finished.load_archive())
