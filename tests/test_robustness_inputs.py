"""The campaign's bad inputs: what is drawn is bad, and the judge sees every promise broken."""

import io
import json
import zipfile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from robustness import damage, hostile, inputs
from robustness.judge import Judge, verdict
from robustness.worker import Ending

from qdenv.agent.convert import read_checkpoint
from qdenv.io.arrays import read_arrays
from qdenv.io.layouts import ENDINGS, read_drawing
from qdenv.simulate.maze.policy import load_weights, shipped_agent
from qdenv.types import InputError

CHANCES = st.integers(0, 2**32).map(np.random.default_rng)
GOOD = Ending(2, "", "\r 10%|#\rqdenv: no\n", [], 0.0, 0.1)

PLANTED = """
import sys
from qdenv.cli import run as whole
def run(argv):
    if argv[0] == "two":
        print("qdenv: one\\nqdenv: two", file=sys.stderr)
        return 2
    if argv[0] == "spin":
        while True:
            pass
    if argv[0] == "grow":
        return 0 * len(b"x" * 2**28)
    if argv[0] == "die":
        import os
        os._exit(9)
    return {}["planted"] if argv[0] == "raise" else whole(argv)
"""


@pytest.fixture(scope="module")
def judge(tmp_path_factory):
    folder = tmp_path_factory.mktemp("planted")
    (folder / "planted.py").write_text(PLANTED)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(folder), prepend=":")
        judge = Judge("planted:run", longest=3.0, most=250.0)
        yield judge
        judge.close()


def test_the_judge_sees_what_is_planted_and_goes_on_after_each(judge, tmp_path):
    for word, said in {
        "raise": "ends in a traceback: KeyError: 'planted'",
        "two": "says 2 lines",
        "grow": "MB more than before",
        "spin": "hangs",
        "die": "dies with exit code 9",
    }.items():
        # The command itself is well, in the same process or in a new one, which takes its time.
        assert judge.fault_of(["check", "nowhere.txt"], tmp_path, limited=False) is None
        found = judge.fault_of([word], tmp_path)
        assert found is not None and said in found
        assert "\n" not in found
    (tmp_path / "plan.txt").write_text("...\n.x\n")
    assert judge.fault_of(["check", "plan.txt"], tmp_path, limited=False) is None


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"code": 3}, "exit code 3"),
        ({"said": ""}, "says 0 lines"),
        ({"said": "warning: x\nqdenv: no\n"}, "says 2 lines"),
        ({"said": "no\n"}, "says 1 lines"),
        ({"said": "qdenv: \x1b[31mno\n"}, "no printable line"),
        ({"logged": ["a\nb"]}, "no printable line"),
        ({"megabytes": 1025.0}, "1025 MB"),
    ],
)
def test_every_promise_is_looked_at(changes, said):
    assert verdict(GOOD) is None
    found = verdict(GOOD._replace(**changes))
    assert found is not None and said in found


def test_inputs_are_the_same_for_the_same_seed(tmp_path, monkeypatch):
    files = {
        "config.json": b"{}",
        "metrics.csv": b"a",
        "checkpoint.npz": shipped_agent().read_bytes(),
    }
    monkeypatch.setattr(inputs, "run_files", lambda made_by=(): files)
    drawn = []
    for copy, now in (("one", 1e9), ("two", 1.1e9)):  # the time is no part of it
        monkeypatch.setattr(zipfile.time, "time", lambda now=now: now)
        chance = np.random.default_rng(8)
        found = []
        for number in range(12):
            folder = tmp_path / copy / str(number)
            folder.mkdir(parents=True)
            found.append(inputs.bad_file(chance, folder))
            found += [path.read_bytes() for path in sorted(folder.rglob("*.*"))]
        drawn.append(found)
    assert drawn[0] == drawn[1]
    assert len({one.kind for one in drawn[0] if isinstance(one, inputs.Input)}) > 2


@settings(max_examples=60, deadline=None)
@given(chance=CHANCES, ending=st.sampled_from(ENDINGS))
def test_spoilt_layouts_are_read_or_refused_in_one_line(chance, ending, tmp_path_factory):
    path = tmp_path_factory.mktemp("layout") / f"plan{ending}"
    path.write_bytes(damage.spoilt(chance, path.name, inputs.drawing(inputs.WAREHOUSE, ending)))
    try:
        assert isinstance(read_drawing(path).rows, list)
    except InputError as error:
        assert str(error).isprintable()


@settings(max_examples=40, deadline=None)
@given(chance=CHANCES)
def test_spoilt_agents_are_read_or_refused_in_one_line(chance, tmp_path_factory):
    path = tmp_path_factory.mktemp("agent") / "a.npz"
    path.write_bytes(damage.spoilt(chance, path.name, shipped_agent().read_bytes()))
    try:
        assert all(np.isfinite(array).all() for array in load_weights(path))
    except InputError as error:
        assert str(error).isprintable()


@settings(max_examples=60, deadline=None)
@given(chance=CHANCES)
def test_hostile_checkpoints_give_arrays_or_one_line(chance, tmp_path_factory):
    path = tmp_path_factory.mktemp("foreign") / "m.tar"
    path.write_bytes(hostile.checkpoint(chance))
    try:
        found = read_checkpoint(path)
    except InputError as error:
        assert str(error).isprintable()
    else:
        assert all(array.dtype == np.float32 for array in found.values())


def test_damage_of_every_kind_changes_what_it_should(tmp_path):
    chance, content = np.random.default_rng(0), b"0123456789" * 20
    for one in damage.DAMAGES:
        assert any(one(chance, content) != content for _ in range(3)), one.__name__
    out = io.BytesIO()
    np.savez(out, a=np.arange(4), b=np.ones((2, 2)))
    good = json.dumps({"a": [1, {"b": 2}], "c": "d"}).encode()
    assert len({damage.twisted(chance, good) for _ in range(50)}) > 30
    refused = 0
    for _ in range(40):
        (tmp_path / "x.npz").write_bytes(damage.rearranged(chance, out.getvalue()))
        assert zipfile.is_zipfile(tmp_path / "x.npz")
        try:
            read_arrays(tmp_path / "x.npz")
        except InputError:
            refused += 1
    assert 5 < refused < 40
