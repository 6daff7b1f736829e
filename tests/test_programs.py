"""Benchmarks and studies: a mistake is one line that says what to do, exit code 2."""

import runpy
import sys

import pytest
from conftest import OWN_LAYOUTS

from qdenv import interrupt

pytestmark = pytest.mark.slow

LAYOUT = OWN_LAYOUTS / "warehouse_even.json"

# What follows `python -m` -> what its one line must say.
MISTAKES = {
    "experiments figure_99": "unknown experiment 'figure_99'",
    "experiments --missing": "--missing needs a value (`python -m experiments --help`",
    "experiments --make table_6": "unknown experiment 'table_6'",
    "experiments --executer dask": "did you mean --executor?",
    "experiments.sphere --seeds many": "--seeds must be an integer, not 'many'",
    "experiments.sphere --seeds 0": "seeds must be at least 1, not 0",
    "experiments.which_nca --preset dsage-quick": "there is no setting 'kernel_sizes'",
    "experiments.own_objective --algorithm magic": "unknown algorithm 'magic'",
    "experiments.zoo nowhere": "nowhere: ",
    "experiments.polish nowhere --layouts 0": "layouts must be at least 1, not 0",
    f"experiments.congestion {LAYOUT} --timesteps 0": "timesteps must be at least 1, not 0",
    "experiments.benchmarks maze --unit 3": "unknown option --unit",
    "experiments.benchmarks speed": "usage: python -m experiments.benchmarks {pipeline,",
}


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """Run a program in this process, as `python -m` does in one of its own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(interrupt, "watch", lambda program: None)

    def run(line):
        module, *words = line.split()
        monkeypatch.setattr("sys.argv", [module, *words])
        for loaded in (module, f"{module}.__main__"):  # may be imported by other tests
            if loaded != "experiments":
                monkeypatch.delitem(sys.modules, loaded, raising=False)
        with pytest.raises(SystemExit) as end:
            runpy.run_module(module, run_name="__main__")
        return end.value.code, *capsys.readouterr()

    return run


@pytest.mark.parametrize("line", MISTAKES)
def test_mistakes(line, run, tmp_path):
    code, out, err = run(line)
    (said,) = err.splitlines()
    assert (code, out) == (2, "")
    assert said.startswith("qdenv: ")
    assert MISTAKES[line] in said
    assert not list(tmp_path.iterdir())


def test_help_lists_the_options(run):
    code, out, err = run("experiments --help")
    assert (code, err) == (0, "")
    assert "--make NAME" in out
