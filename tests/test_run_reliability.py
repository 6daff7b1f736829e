"""Runs that were killed, damaged, edited or started twice: one line, and the same bits."""

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest
import toy

from qdenv.agent.train import save_weights
from qdenv.cli.main import run as command
from qdenv.domains.maze import MazeConfig, agent_weights, checksum_of_agent
from qdenv.io.files import LOCK, TEMPORARY_PREFIX
from qdenv.ops.runs import plot_one
from qdenv.pipeline import EvaluationConfig, PipelinedEvaluator
from qdenv.run import loop
from qdenv.run.config import RunConfig, override
from qdenv.run.directory import RunDirectory
from qdenv.search.cma_mae import CmaMaeConfig
from qdenv.simulation.maze.policy import load_weights
from qdenv.types import InputError

pytestmark = pytest.mark.slow

SHORT = replace(toy.CONFIG, evaluations=32)  # four iterations, checkpoints after 2 and 4


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> RunDirectory:
    return loop.train(SHORT, tmp_path_factory.mktemp("run") / "whole", progress=False)


@pytest.fixture
def run(whole, tmp_path) -> RunDirectory:
    """Copy the finished run, to be damaged."""
    return RunDirectory.open(shutil.copytree(whole.path, tmp_path / "copy"))


@pytest.mark.parametrize("lost", ["archive.npz", "best_layout.json"])
def test_a_finished_run_gets_back_what_its_end_did_not_write(lost, whole, run):
    (run.path / lost).unlink()
    again = loop.resume(run.path, progress=False)
    assert toy.same(again.archive.columns, whole.archive.columns)
    assert (run.path / lost).read_bytes() == (whole.path / lost).read_bytes()


def test_an_archive_older_than_the_last_checkpoint_is_brought_up_to_date(whole, tmp_path):
    # As after a kill between the last checkpoint and the archive.
    half = loop.train(replace(SHORT, evaluations=16), tmp_path / "half", progress=False)
    old = (half.path / "archive.npz").read_bytes()
    loop.resume(half.path, False, 32)
    (half.path / "archive.npz").write_bytes(old)
    assert not toy.same(half.archive.columns, whole.archive.columns)
    assert toy.same(loop.resume(half.path, progress=False).archive.columns, whole.archive.columns)


DAMAGES = {
    "cut": lambda content: content[: len(content) // 2],
    "one byte": lambda content: content[:3000] + bytes([content[3000] ^ 255]) + content[3001:],
    "empty": lambda content: b"",
    "zeros": lambda content: bytes(len(content)),
    "no archive": lambda content: b"PK\3\4",
}


@pytest.mark.parametrize("kind", DAMAGES)
def test_a_damaged_checkpoint_is_passed_over_for_the_one_before(kind, whole, run, caplog):
    newest = run.path / "checkpoints" / "000004.npz"
    newest.write_bytes(DAMAGES[kind](newest.read_bytes()))
    (run.path / "checkpoints" / "1-notes.npz").write_bytes(b"not ours")
    assert toy.same(loop.resume(run.path, progress=False).archive.columns, whole.archive.columns)
    (warning,) = caplog.messages
    assert "000004.npz" in warning and "the checkpoint before it" in warning
    assert (run.path / "checkpoints" / "1-notes.npz").exists()


@pytest.mark.parametrize("lost", [(), ("checkpoints",), ("checkpoints", "archive.npz")])
def test_a_run_without_a_whole_checkpoint_stays_as_it_is(lost, run):
    for path in (run.path / "checkpoints").iterdir():
        path.write_bytes(b"")
    for name in lost:
        path = run.path / name
        path.unlink() if path.is_file() else shutil.rmtree(path)
    before = toy.files(run.path)
    with pytest.raises(InputError, match="train in another folder"):
        loop.resume(run.path, progress=False)
    assert toy.files(run.path) == before


HOLDER = """
import sys
from pathlib import Path
from qdenv.run.directory import RunDirectory
with RunDirectory(Path(sys.argv[1])).locked():
    print("held", flush=True)
    sys.stdin.read()
"""


def test_a_second_process_is_refused_and_a_dead_one_leaves_no_lock(run):
    command = [sys.executable, "-c", HOLDER, str(run.path)]
    holder = subprocess.Popen(command, stdin=-1, stdout=-1, text=True)
    try:
        assert holder.stdout.readline() == "held\n"
        before = toy.files(run.path)
        with pytest.raises(InputError, match="another process is at work"):
            loop.resume(run.path, False, 48)
        assert before == toy.files(run.path)
    finally:
        holder.kill()
        holder.communicate()
    assert len(loop.resume(run.path, False, 40).read_metrics()) == 5


def test_what_killed_processes_left_half_written_is_swept_and_nothing_else(whole, run):
    names = {path.relative_to(run.path) for path in run.path.rglob("*")}
    left = [f"{TEMPORARY_PREFIX}abc_1234", f"checkpoints/{TEMPORARY_PREFIX}zzzzzzzz"]
    # The second is of a run at work in a folder within; old versions of filelock empty their file.
    theirs = [".notes", f"within/{TEMPORARY_PREFIX}abc_1234", ".lock"]
    (run.path / "within").mkdir()
    for name in [*left, *theirs]:
        (run.path / name).write_bytes(b"half")
    loop.resume(run.path, progress=False)
    now = {path.relative_to(run.path) for path in run.path.rglob("*")}
    assert (now ^ names) - {Path(LOCK)} == {Path("within"), *map(Path, theirs)}
    assert {(run.path / name).read_bytes() for name in theirs} == {b"half"}


@pytest.mark.parametrize("name", ["metrics.csv", LOCK, "checkpoints", "checkpoints/000002.npz"])
def test_nothing_is_written_through_links_of_a_run(name, run, tmp_path):
    outside, inside = tmp_path / "outside", run.path / name
    if name == "checkpoints":
        inside.rename(outside)
    else:
        outside.write_text("theirs")
        inside.unlink(missing_ok=True)
    inside.symlink_to(outside)
    before = [(path, path.read_bytes()) for path in tmp_path.rglob("*") if path.is_file()]
    with pytest.raises(InputError, match=f"{name}: is a link"):
        loop.resume(run.path, False, 48)
    with pytest.raises(InputError, match=f"{name}: is a link"):
        plot_one(run)
    assert before == [(path, path.read_bytes()) for path in tmp_path.rglob("*") if path.is_file()]


def test_more_memory_than_there_is_is_refused_before_a_folder_exists(tmp_path, monkeypatch):
    monkeypatch.setattr("os.sysconf", lambda name: 10)  # a hundred bytes
    with pytest.raises(InputError, match="GiB of memory: choose fewer emitters"):
        loop.train(SHORT, tmp_path / "run", progress=False)
    assert not list(tmp_path.iterdir())


def test_single_precision_is_a_condition(tmp_path):
    jax.config.update("jax_enable_x64", True)  # `jax.enable_x64` is newer than the lowest version
    try:
        with pytest.raises(InputError, match="JAX_ENABLE_X64"):
            loop.train(SHORT, tmp_path / "run", progress=False)
    finally:
        jax.config.update("jax_enable_x64", False)
    assert not list(tmp_path.iterdir())


def edited(run: RunDirectory, **changes: object) -> None:
    path = run.path / "config.json"
    content = json.loads(path.read_text())
    for name, value in changes.items():
        part, _, inner = name.partition("__")
        content[part] = {**content[part], inner: value} if inner else value
    path.write_text(json.dumps(content))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"seed": 5}, "made with seed 0, now it is 5: put that back, or train in another folder"),
        ({"archive": [[0, 30, 6], [0, 6, 10]]}, "made with archive [[0.0, 30.0, 10], [0.0, 6"),
        # Another form of the state is refused without a look at the settings.
        ({"algorithm__emitters": 4, "algorithm__batch": 2}, "belongs to another configuration"),
        ({"evaluation__simulations": 2}, "belongs to another configuration"),
    ],
)
def test_a_run_whose_settings_were_edited_is_not_continued(changes, said, run):
    edited(run, **changes)
    before = (run.path / "config.json").read_bytes()
    with pytest.raises(InputError) as refusal:
        loop.resume(run.path, False, 48)
    assert said in str(refusal.value) and "\n" not in str(refusal.value)
    assert (run.path / "config.json").read_bytes() == before


def test_a_maze_run_goes_on_with_the_agent_it_began_with_only(tmp_path):
    agent, other = tmp_path / "agent.npz", tmp_path / "other.npz"
    weights = load_weights()
    save_weights(weights, agent)
    save_weights(weights._replace(value_bias=weights.value_bias + 1), other)
    domain = MazeConfig(rows=8, cols=8, timesteps=20, agent=str(agent))
    evaluation = EvaluationConfig(domain, toy.CONFIG.evaluation.generator, simulations=2)
    config = RunConfig(evaluation, CmaMaeConfig(emitters=1, batch=4), 8, checkpoint_every=1)
    begun = loop.train(config, tmp_path / "begun", progress=False)
    manifest = json.loads((begun.path / "manifest.json").read_text())
    assert manifest["reads"] == {"agent": checksum_of_agent("")} != {}
    own = agent.read_bytes()

    agent.write_bytes(other.read_bytes())
    agent_weights.cache_clear()
    before = toy.files(begun.path)
    with pytest.raises(InputError, match=r"made with the agent of checksum .*, now it is"):
        loop.resume(begun.path, False, 16)
    assert before == toy.files(begun.path)

    agent.write_bytes(own)
    agent_weights.cache_clear()
    assert len(loop.resume(begun.path, False, 16).read_metrics()) == 4


def test_settings_that_decide_no_result_may_change(whole, run):
    edited(run, checkpoint_every=7)
    assert toy.same(loop.resume(run.path, progress=False).archive.columns, whole.archive.columns)


def test_a_checkpoint_of_an_older_qdenv_that_names_no_settings_goes_on(whole, tmp_path):
    half = loop.train(replace(SHORT, evaluations=16), tmp_path / "half", progress=False)
    newest = half.path / "checkpoints" / "000002.npz"
    with np.load(newest) as file:
        arrays = dict(file)
    facts = json.loads(arrays.pop("manifest").tobytes())
    assert facts.pop("settings")["algorithm.emitters"] == 2
    arrays["manifest"] = np.frombuffer(json.dumps(facts).encode(), np.uint8)
    np.savez(newest, **arrays)
    assert toy.same(loop.resume(half.path, False, 32).archive.columns, whole.archive.columns)


@pytest.mark.parametrize("evaluations", [8, 24])
def test_a_total_below_what_is_done_is_refused_and_nothing_written(evaluations, run):
    before = (run.path / "config.json").read_bytes()
    with pytest.raises(InputError, match="32 evaluations are done already"):
        loop.resume(run.path, False, evaluations)
    assert (run.path / "config.json").read_bytes() == before


def test_an_interrupted_run_keeps_its_last_iteration(whole, tmp_path, monkeypatch):
    calls, original = [], PipelinedEvaluator.begin

    def stop_in_the_fourth(self, parameters, key):
        calls.append(1)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return original(self, parameters, key)

    monkeypatch.setattr(PipelinedEvaluator, "begin", stop_in_the_fourth)
    with pytest.raises(KeyboardInterrupt):
        loop.train(replace(SHORT, checkpoint_every=10), tmp_path / "run", progress=False)
    monkeypatch.undo()
    stopped = RunDirectory.open(tmp_path / "run")
    assert max(path.name for path in stopped.path.glob("checkpoints/*")) == "000003.npz"
    assert len(stopped.archive) > 0 and len(stopped.read_metrics()) == 3
    assert toy.same(loop.resume(stopped.path, False).archive.columns, whole.archive.columns)


def test_metrics_that_were_cut_do_not_stop_a_run(whole, run, caplog):
    table = run.path / "metrics.csv"
    table.write_text(table.read_text()[:-9])
    resumed = loop.resume(run.path, False, 40)
    assert "is lost" in caplog.text
    assert [row.iteration for row in resumed.read_metrics()] == [1, 2, 3, 5]


SETTINGS = [
    {"evaluations": 0},
    {"evaluations": -10},
    {"checkpoint_every": 0},
    {"seed": 2**31},
    {"seed": 2**63},
    {"archive": ((0, 30, 5),)},
    {"archive": ((40, 0, 20), (0, 6, 6))},
    {"archive": ((0, 40, 0), (0, 6, 6))},
    {"archive": ((0, float("inf"), 4), (0, 6, 6))},
    {"simulations": 0},
    {"alpha": float("nan")},
    {"alpha": float("inf")},
    {"hidden": 0},
    {"steps": -1},
    {"kernel_sizes": ()},
    {"batch": 0},
]


@pytest.mark.parametrize("changes", SETTINGS, ids=str)
def test_settings_that_make_no_run_are_refused_before_any_folder_is_made(changes, tmp_path):
    with pytest.raises(InputError) as refusal:
        loop.train(override(toy.CONFIG, changes), tmp_path / "run", progress=False)
    assert "\n" not in str(refusal.value)
    assert not (tmp_path / "run").exists()


FILES = {
    "archive.npz": [b"", b"PK\3\4", b"hello", None],
    "manifest.json": [
        b"", b"[]", b"{}", b'{"schema": "1"}', b'{"schema": null}', b"[" * 100_000,
        b'{"schema": 2, "tiles": ".", "measures": [3]}',
        b'{"schema": 2, "tiles": ".", "measures": [{"name": "x"}]}',
        b'{"schema": 2, "tiles": ".", "measures": [{"name": 3, "low": 0, "high": 1, "cells": 5}]}',
        b'{"schema": 2, "measures": [{"name": "x", "low": 0, "high": NaN, "cells": 5}]}',
        b'{"schema": 1e400, "tiles": ".", "measures": []}',
    ],
    "config.json": [
        b"", b"{}", b"[" * 100_000, b'{"evaluation": {}}', b'{"evaluation": {}, "algorithm": 3}',
        b'{"evaluation": {"domain": {"name": []}}}', b'{"evaluation": {"domain": "moon"}}',
    ],
    "metrics.csv": [b"", b"iteration\nmany\n", b'a,"' + b"x" * 200_000, None,
        b"iteration,evaluations,qd_score,coverage,best_objective,seconds\n1,8,nan,0.1,0.7,3\n"],
}  # fmt: skip


@pytest.mark.parametrize("name", FILES)
def test_damaged_files_give_one_line(name, run, capsys):
    for content in FILES[name]:
        if content is None:
            (run.path / name).unlink(missing_ok=True)
        else:
            (run.path / name).write_bytes(content)
        code = command(["resume" if name == "config.json" else "plot", str(run.path)])
        said = capsys.readouterr().err
        assert code == 2, content
        assert said.startswith("qdenv: ") and said.count("\n") == 1, content


def test_an_archive_of_other_columns_gives_one_line(run):
    good = run.archive.columns
    for wrong in (
        {"index": good["index"]},
        good | {"index": good["index"] + 1000},
        good | {"index": good["index"].astype(float)},
        good | {"objective": good["objective"][:-1]},
        good | {"measures": good["measures"][:, :1]},
        good | {"similarity": np.float32(0)},
        {name: column for name, column in good.items() if name != "repaired"},
        good | {"repaired": good["repaired"] + 50},
        good | {"repaired": good["repaired"][:, 0]},
        good | {"objective": np.full_like(good["objective"], np.nan)},
        good | {"index": np.zeros_like(good["index"])},
        good | {"similarity": good["similarity"].astype("U9")},
        good | {"success": np.zeros(len(good["index"]), bool)},
        good | {"unrepaired": good["repaired"][:, :2]},
        good | {"similarity": np.zeros((len(good["index"]), 0))},
    ):
        np.savez(run.path / "archive.npz", **wrong)
        with pytest.raises(InputError, match=r"archive\.npz: cannot be read"):
            len(run.archive)


def test_the_algorithm_of_the_toy_is_the_one_the_edits_assume():
    assert toy.CONFIG.algorithm == CmaMaeConfig(emitters=2, batch=4, sigma0=0.5)
