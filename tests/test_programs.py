"""Benchmarks and studies: a mistake is one line that says what to do, exit code 2."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

HERE = Path(__file__).parents[1]

# What follows `python -m` -> what its one line must say.
MISTAKES = {
    "experiments --missing": "--missing needs a value (`python -m experiments --help`",
    "experiments --make table_6": "unknown experiment 'table_6'",
    "experiments --executer dask": "did you mean --executor?",
    "experiments.sphere --seeds many": "--seeds must be an integer, not 'many'",
    "experiments.own_objective --algorithm magic": "unknown algorithm 'magic'",
    "experiments.zoo nowhere": "nowhere: ",
    "experiments.benchmarks maze --unit 3": "unknown option --unit",
    "experiments.benchmarks speed": "usage: python -m experiments.benchmarks {pipeline,",
}


def python(*arguments: str, folder: Path) -> subprocess.CompletedProcess:
    paths = {"PYTHONPATH": str(HERE)}
    command = [sys.executable, "-m", *arguments]
    return subprocess.run(
        command, cwd=folder, env=os.environ | paths, capture_output=True, text=True, check=False
    )


@pytest.mark.parametrize("line", MISTAKES)
def test_mistakes(line, tmp_path):
    done = python(*line.split(), folder=tmp_path)
    (said,) = done.stderr.splitlines()
    assert (done.returncode, done.stdout) == (2, "")
    assert said.startswith("qdenv: ")
    assert MISTAKES[line] in said
    assert not list(tmp_path.iterdir())


def test_help_lists_the_options(tmp_path):
    done = python("experiments", "--help", folder=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert "--make NAME" in done.stdout
