"""The benchmark of the surrogate: what it says of a preset, and what it reckons."""

import json

import pytest

from experiments.benchmarks.surrogate import SIZES, Options, reckon, run, searched
from qdenv.surrogate.settings import SurrogateConfig
from qdenv.types import InputError


def test_an_outer_loop_is_reckoned_from_iterations_and_steps():
    measured = {"wall": 0.5, "cpu": 0.25}
    result = {"inner_iteration": measured, "step": {"usage": measured, "score": measured}}
    options = Options(inner_iterations=100, epochs=2, samples=65)  # two steps an epoch
    assert reckon(options, result) == {"wall": 50 + 4, "cpu": 25 + 2}


@pytest.mark.parametrize(
    ("preset", "shape", "kinds", "repairs", "size"),
    [
        ("warehouse-even", (33, 36), 4, True, 33 * 32),
        ("maze-walls", (18, 18), 2, False, 256),
    ],
)
def test_a_preset_says_what_is_searched(preset, shape, kinds, repairs, size):
    problem = searched(preset)
    drawing = problem.drawing
    assert (drawing.shape, drawing.kinds, drawing.repairs) == (shape, kinds, repairs)
    assert problem.solution_dim == size and len(problem.measures) == 2


def test_everything_is_measured_and_written(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(SIZES, "small", SurrogateConfig(channels=1, blocks=0))
    file = tmp_path / "surrogate.json"
    run(Options(preset="maze-quick", timed=1, repeats=1), file)
    result = json.loads(file.read_text())
    assert result["parameters"].keys() == result["step"].keys()
    spent = [result["inner_iteration"], *result["step"].values(), result["outer_loop"]]
    assert all(row["wall"] > 0 and row["cpu"] > 0 for row in spent)
    assert result["peak_bytes"] > 2**20 and "outer loop of 10,000" in capsys.readouterr().out


def test_an_unknown_preset_is_refused():
    with pytest.raises(InputError, match="unknown preset"):
        searched("no-such-preset")
