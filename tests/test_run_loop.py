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
from fleet_runs import StandConfig

from qdenv.agent.settings import TrainConfig
from qdenv.domains.base import DOMAINS
from qdenv.domains.warehouse import WarehouseConfig
from qdenv.io.files import LOCK
from qdenv.ops.networks import train_agent
from qdenv.pipeline import PipelinedEvaluator, evaluate, make_pipeline
from qdenv.registry import Entry
from qdenv.run import loop
from qdenv.run.directory import RunDirectory
from qdenv.run.evaluate import Threads
from qdenv.run.experiment import make_experiment, make_iteration, observed
from qdenv.shipped import HOME
from qdenv.simulation.mapf.fleet import FleetConfig
from qdenv.types import InputError, RepairStatus

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("emitted")]

HERE = Path(__file__).parent


class CountedGarden(toy.GardenConfig):
    """A garden whose simulator counts how often it is traced."""


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> RunDirectory:
    path = tmp_path_factory.mktemp("run") / "whole"
    return loop.train(toy.CONFIG, path, progress=False)


def test_jitted_scan_and_pipelined_loop_give_the_same_archive(finished):
    traces = []

    def counted(config):
        domain = toy.garden(config)
        run = domain.simulator.run
        counting = domain.simulator._replace(run=lambda *given: traces.append(1) or run(*given))
        return replace(domain, simulator=counting)

    DOMAINS.register("counted garden", Entry(CountedGarden, counted))
    evaluation = replace(toy.CONFIG.evaluation, domain=CountedGarden())
    experiment = make_experiment(replace(toy.CONFIG, evaluation=evaluation))
    state = experiment.algorithm.init(experiment.search_key)
    iterate = make_iteration(experiment)
    before = len(traces)
    whole = jax.jit(
        lambda state: jax.lax.scan(lambda s, i: (iterate(s, i), None), state, np.arange(1, 7))[0]
    )
    state = whole(state)
    whole(state)
    assert len(traces) == before + 1
    assert toy.same(experiment.algorithm.archive(state).elites(), finished.archive.columns)

    evaluator = PipelinedEvaluator(experiment.pipeline, Threads(experiment.pipeline))
    before, ask = len(traces), jax.jit(experiment.algorithm.ask)
    for number in range(3):
        solutions, state = ask(state)
        evaluator.begin(solutions, jax.random.key(number))()
    assert len(traces) == before + 1


def test_an_evaluation_does_not_depend_on_its_batch():
    experiment = make_experiment(toy.CONFIG)
    parameters = jax.random.normal(jax.random.key(3), (8, experiment.pipeline.solution_size))
    key = jax.random.key(4)
    whole = jax.jit(lambda some: evaluate(experiment.pipeline, some, key))(parameters)
    part = jax.jit(lambda some: evaluate(experiment.pipeline, some, key))(parameters[:3])
    jax.tree.map(lambda all, some: np.testing.assert_array_equal(all[:3], some), whole, part)


@pytest.mark.parametrize("lanes", [2, 5, 100])
def test_lanes_change_nothing(lanes, monkeypatch):
    layouts = np.random.default_rng(0).integers(0, 3, (4, 5, 6)).astype(np.int8)
    indices, key = np.arange(4), jax.random.key(5)
    seen = [make_pipeline(toy.CONFIG.evaluation).simulate(layouts, indices, key).seen]
    monkeypatch.setattr("qdenv.devices.lanes", lambda *wanted: lanes)
    seen += [make_pipeline(toy.CONFIG.evaluation).simulate(layouts, indices, key).seen]
    assert np.asarray(seen[0]).std() > 0
    np.testing.assert_array_equal(*seen)


def test_resumed_run_ends_at_the_same_bits(finished, tmp_path):
    config = replace(toy.CONFIG, evaluations=24)
    loop.train(config, tmp_path / "half", progress=False)
    resumed = loop.resume(tmp_path / "half", False, toy.CONFIG.evaluations)
    assert toy.same(resumed.archive.columns, finished.archive.columns)
    without_time = [row._replace(seconds=0) for row in resumed.read_metrics()]
    assert without_time == [row._replace(seconds=0) for row in finished.read_metrics()]


# A child process that dies by SIGKILL at the chosen place of its third iteration or checkpoint.
CHILD = """
import os, signal, sys
sys.path.insert(0, {here!r})
import toy
from qdenv.io import files
from qdenv.run import evaluate, loop

def die(*args, **kwargs):
    os.kill(os.getpid(), signal.SIGKILL)

if {where!r} == "iteration":
    original, calls = evaluate.observed, []
    def observe(evaluation):
        calls.append(1)
        return original(evaluation) if len(calls) < 5 else die()
    evaluate.observed = observe
else:
    original = loop.save_checkpoint
    def save(path, iteration, state, settings):
        if iteration >= 4:
            os.replace = die  # the temporary file is written, its renaming never happens
        original(path, iteration, state, settings)
    loop.save_checkpoint = save
loop.train(toy.CONFIG, {path!r}, progress=False)
"""


@pytest.mark.parametrize("where", ["iteration", "checkpoint"])
def test_killed_run_resumes_to_the_same_bits(where, finished, tmp_path):
    path = tmp_path / "killed"
    script = CHILD.format(here=str(HERE), where=where, path=str(path))
    child = subprocess.run([sys.executable, "-c", script], capture_output=True, env=os.environ)
    assert child.returncode == -signal.SIGKILL, child.stderr.decode()
    survived = RunDirectory.open(path)
    assert 0 < len(survived.read_metrics()) < 6
    theirs = {path / ".env.template", path / "checkpoints" / ".env.defaults"}
    for file in theirs:
        file.write_text("theirs")
    resumed = loop.resume(path, progress=False)
    assert toy.same(resumed.archive.columns, finished.archive.columns)
    assert {file for file in path.rglob(".*") if file.name != LOCK} == theirs


def test_metrics_have_the_promised_columns_and_grow(finished):
    text = (finished.path / "metrics.csv").read_text()
    header = (
        "iteration,evaluations,qd_score,coverage,best_objective,seconds,"
        "failed_repairs,congested_runs"
    )
    assert text.splitlines()[0] == header
    rows = finished.read_metrics()
    assert [row.evaluations for row in rows] == [8, 16, 24, 32, 40, 48]
    assert all(a.coverage <= b.coverage and a.seconds < b.seconds for a, b in pairwise(rows))
    cells = np.prod(finished.archive.shape)
    assert rows[-1].coverage == len(finished.archive) / cells  # to the last bit


def test_archive_keeps_layouts_that_obey_the_rules(finished):
    archive = finished.archive.columns
    assert archive["unrepaired"].shape == archive["repaired"].shape == (len(archive["index"]), 5, 6)
    assert ((archive["repaired"] == 2).sum(axis=(1, 2)) == 3).all()
    np.testing.assert_allclose(archive["seen"].mean(axis=1), archive["objective"], rtol=1e-6)
    agree = (archive["unrepaired"] == archive["repaired"]).mean(axis=(1, 2))
    np.testing.assert_allclose(archive["similarity"], agree, rtol=1e-6)


def test_config_returns_from_json(finished):
    assert RunDirectory.open(finished.path).config == toy.CONFIG


def test_failed_evaluations_enter_nothing():
    # 30 cells cannot hold 40 hedges: every repair says so, and the archive stays empty.
    config = replace(
        toy.CONFIG, evaluation=replace(toy.CONFIG.evaluation, domain=toy.GardenConfig(hedges=40))
    )
    experiment = make_experiment(config)
    begin = jax.jit(lambda key: experiment.algorithm.ask(experiment.algorithm.init(key)))
    solutions, state = begin(experiment.search_key)
    pipeline = experiment.pipeline
    evaluation = PipelinedEvaluator(pipeline, Threads(pipeline)).begin(
        solutions, jax.random.key(0)
    )()
    assert (np.asarray(evaluation.status) == RepairStatus.IMPOSSIBLE).all()
    assert not np.asarray(evaluation.score.success).any()
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(evaluation.score))
    tell = jax.jit(experiment.algorithm.tell)
    state = tell(state, solutions, evaluation.score, observed(evaluation))
    assert len(experiment.algorithm.archive(state).elites()["index"]) == 0


def test_a_search_stops_where_no_layout_of_an_iteration_can_be_repaired(tmp_path, monkeypatch):
    # Rules that counting finds possible may be impossible all the same; these let it be seen.
    monkeypatch.setattr(loop, "check", lambda config: None)
    evaluation = replace(toy.CONFIG.evaluation, domain=toy.GardenConfig(hedges=40))
    config = replace(toy.CONFIG, evaluation=evaluation, evaluations=16)
    with pytest.raises(InputError, match="none of 8 layouts could be repaired"):
        loop.train(config, tmp_path / "run", progress=False)
    (row,) = RunDirectory.open(tmp_path / "run").read_metrics()
    assert (row.failed_repairs, row.congested_runs) == (8, 0)


def test_metrics_count_congested_runs(tmp_path):
    fleet = FleetConfig(agents=4, timesteps=20, planner=StandConfig())
    domain = WarehouseConfig(rows=9, cols=10, shelves=6, fleet=fleet)
    evaluation = replace(toy.CONFIG.evaluation, domain=domain)
    archive = ((0, 6, 6), (0, 1, 10))
    config = replace(toy.CONFIG, evaluation=evaluation, evaluations=8, archive=archive)
    (row,) = loop.train(config, tmp_path / "run", progress=False).read_metrics()
    assert (row.failed_repairs, row.congested_runs) == (0, 8 * 3)  # nobody ever moves


def test_a_run_is_never_overwritten_and_a_newer_one_not_opened(finished, tmp_path):
    with pytest.raises(InputError, match="holds a run already"):
        loop.train(toy.CONFIG, finished.path, progress=False)
    with pytest.raises(InputError, match="no run here"):
        RunDirectory.open(tmp_path)
    for name in ("metrics.csv", "agent.npz", "manifest.json"):  # of somebody, not of a run
        (tmp_path / name).write_text("{}")
        with pytest.raises(InputError, match=f"{name}: a run would replace it"):
            loop.train(toy.CONFIG, tmp_path, progress=False)
        assert [path.name for path in tmp_path.iterdir()] == [name]
        (tmp_path / name).unlink()
    with pytest.raises(InputError, match="holds a run already"):
        train_agent(TrainConfig(), finished.path)
    with pytest.raises(InputError, match="ships with qdenv"):
        train_agent(TrainConfig(), RunDirectory.open("zoo:maze-walls").path)
    with pytest.raises(InputError, match="this folder ships with qdenv"):
        loop.train(toy.CONFIG, HOME / "new", progress=False)
    (tmp_path / "config.json").write_text("{}")
    (tmp_path / "manifest.json").write_text('{"schema": 99}')
    with pytest.raises(InputError, match="newer"):
        RunDirectory.open(tmp_path)


def test_a_full_disk_keeps_what_was_written(finished, tmp_path, monkeypatch):
    config = replace(toy.CONFIG, evaluations=16)
    run = loop.train(config, tmp_path / "run", progress=False)
    before = toy.files(run.path)

    def full(handle: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(InputError, match="No space left on device"):
        loop.resume(run.path, progress=False, evaluations=48)
    monkeypatch.undo()
    assert before == toy.files(run.path)
    resumed = loop.resume(run.path, progress=False, evaluations=48)
    assert toy.same(resumed.archive.columns, finished.archive.columns)
