"""The campaign's bad inputs are bad and repeatable, and its sandbox finds every broken promise."""

import html
import io
import json
import zipfile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from robustness import corrupt, edges, inputs
from robustness.sandbox import Ending, Sandbox, fault_in, start

from qdenv import InputError
from qdenv.agent.convert import read_checkpoint
from qdenv.io.arrays import read_arrays
from qdenv.io.layouts import read_drawing
from qdenv.simulation.maze.policy import SHIPPED_AGENT, load_weights

pytestmark = pytest.mark.slow

RNGS = st.integers(0, 2**32).map(np.random.default_rng)
GOOD = Ending(2, "", "\r 10%|#\rqdenv: no\n", [], 0.0)
PLANTED = """
import logging
import os
import sys
def run(argv):
    if argv[0] == "two":
        print("qdenv: one\\nqdenv: two", file=sys.stderr)
        return 2
    if argv[0] == "log":
        logging.getLogger("qdenv.x").warning("one\\ntwo")
    if argv[0] == "spin":
        while True:
            pass
    if argv[0] == "grow":
        return 0 * len(b"x" * 2**28)
    if argv[0] == "die":
        os._exit(9)
    return {}["planted"] if argv[0] == "raise" else 0
"""


def test_the_sandbox_finds_planted_faults_and_goes_on_after_each(tmp_path, monkeypatch):
    (tmp_path / "planted.py").write_text(PLANTED)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")
    sandbox = Sandbox("planted:run", longest=0.5, most=250.0)
    for word, message in {
        "raise": "ends in a traceback: KeyError: 'planted'",
        "two": "says 2 lines",
        "log": "no printable line",
        "grow": "MB more than before",
        "spin": "hangs",
        "die": "dies with exit code 9",
    }.items():
        assert sandbox.fault_of(["fine"], tmp_path, limited=False) is None
        fault = sandbox.fault_of([word], tmp_path)
        assert fault is not None and message in fault and "\n" not in fault
    sandbox.close()


@pytest.mark.parametrize(
    ("attack", "program"),
    [
        (edges.run_together, "open('same', 'w').write('x'); print('same')"),
        (edges.run_together, "open(str(os.getpid()), 'w'); print(os.getpid())"),
        (edges.fill, "open('plan.json', 'w')"),
        (edges.fill, "open('.qdenv-tmp-left', 'w')"),
        (edges.redirect, "raise OSError"),
        (edges.spoil_cache, "print(41)"),
    ],
)
def test_planted_faults_at_the_edges_are_found(attack, program, tmp_path, monkeypatch):
    monkeypatch.setattr(edges, "run_files", lambda: {})

    def planted(argv, folder, prepare="0", **streams):
        return start(["-c", f"import os; {program}"], folder, "0", **streams)

    monkeypatch.setattr(edges, "start", planted)
    assert attack(np.random.default_rng(3), tmp_path)


def test_a_script_in_a_name_is_found_where_it_would_run():
    assert edges.runs_script(f"<script>{edges.SCRIPT}") and edges.runs_script(f"<p>{edges.SCRIPT}")
    assert not edges.runs_script(f"<p>{html.escape(edges.SCRIPT)}")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"code": 3}, "exit code 3"),
        ({"stderr": ""}, "says 0 lines"),
        ({"stderr": "warning: x\nqdenv: no\n"}, "says 2 lines"),
        ({"stderr": "no\n"}, "says 1 lines"),
        ({"stderr": "qdenv: \x1b[31mno\n"}, "no printable line"),
        ({"log": ["a\nb"]}, "no printable line"),
        ({"megabytes": 1025.0}, "1025 MB"),
    ],
)
def test_every_promise_is_checked(changes, message):
    assert fault_in(GOOD) is None
    fault = fault_in(GOOD._replace(**changes))
    assert fault is not None and message in fault


def test_inputs_are_the_same_for_the_same_seed(tmp_path, monkeypatch):
    checkpoint = SHIPPED_AGENT.read_bytes()
    files = {"config.json": b"{}", "metrics.csv": b"a", "checkpoint.npz": checkpoint}
    monkeypatch.setattr(inputs, "run_files", lambda made_by=(): files)
    drawn = []
    for now in (1e9, 1.1e9):  # the time is no part of it
        monkeypatch.setattr(zipfile.time, "time", lambda now=now: now)
        rng = np.random.default_rng(8)
        drawn.append([])
        for number in range(12):
            folder = tmp_path / str(now) / str(number)
            folder.mkdir(parents=True)
            drawn[-1].append(inputs.bad_file(rng, folder))
            drawn[-1] += [path.read_bytes() for path in sorted(folder.rglob("*.*"))]
    assert drawn[0] == drawn[1]
    assert len({bad.kind for bad in drawn[0] if isinstance(bad, inputs.Input)}) > 2


@pytest.mark.parametrize(("form", "ending"), inputs.FORMS)
@settings(max_examples=30, deadline=None)
@given(rng=RNGS)
def test_corrupt_layouts_are_read_or_refused_in_one_line(rng, form, ending, tmp_path_factory):
    folder, good = tmp_path_factory.mktemp("layout"), inputs.foreign_files(form, ending)
    name = corrupt.pick(rng, [*good])
    inputs.write(folder, good | {name: corrupt.corrupt(rng, name, good[name])})
    try:
        assert isinstance(read_drawing(folder / f"plan{ending}", form)[0], list)
    except InputError as error:
        assert str(error).isprintable() and str(folder) in str(error)


@settings(max_examples=40, deadline=None)
@given(rng=RNGS)
def test_corrupt_agents_are_read_or_refused_in_one_line(rng, tmp_path_factory):
    path = tmp_path_factory.mktemp("agent") / "a.npz"
    path.write_bytes(corrupt.corrupt(rng, path.name, SHIPPED_AGENT.read_bytes()))
    try:
        assert all(np.isfinite(array).all() for array in load_weights(path))
    except InputError as error:
        assert str(error).isprintable()


@settings(max_examples=60, deadline=None)
@given(rng=RNGS)
def test_hostile_checkpoints_give_arrays_or_one_line(rng, tmp_path_factory):
    path = tmp_path_factory.mktemp("foreign") / "m.tar"
    path.write_bytes(corrupt.hostile_checkpoint(rng))
    try:
        arrays = read_checkpoint(path)
    except InputError as error:
        assert str(error).isprintable()
    else:
        assert all(array.dtype == np.float32 for array in arrays.values())


def test_every_kind_of_damage_changes_the_content(tmp_path):
    rng, content = np.random.default_rng(0), b"0123456789" * 20
    for damage in corrupt.DAMAGES:
        assert any(damage(rng, content) != content for _ in range(3)), damage.__name__
    good = json.dumps({"a": [1, {"b": 2}], "c": "d"}).encode()
    assert len({corrupt.corrupt_json(rng, good) for _ in range(50)}) > 30
    out, refused = io.BytesIO(), 0
    np.savez(out, a=np.arange(4), b=np.ones((2, 2)))
    for _ in range(40):
        (tmp_path / "x.npz").write_bytes(corrupt.corrupt_npz(rng, out.getvalue()))
        assert zipfile.is_zipfile(tmp_path / "x.npz")
        try:
            read_arrays(tmp_path / "x.npz")
        except InputError:
            refused += 1
    assert 5 < refused < 40
