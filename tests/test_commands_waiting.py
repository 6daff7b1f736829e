"""What a person sees while a command works."""

import time

import numba
import pytest

from qdenv.commands import waiting as face
from qdenv.commands.waiting import waiting


@pytest.fixture
def impatient(monkeypatch):
    """Show a bar after a hundredth of a second, and move it as often."""
    monkeypatch.setattr(face, "PATIENCE", 0.01)
    monkeypatch.setattr(face, "TICK", 0.01)


def wait_for(text, capsys):
    """Read what is shown until it holds `text`, for ten seconds at most."""
    said, end = "", time.perf_counter() + 10
    while text not in said and time.perf_counter() < end:
        time.sleep(0.01)
        said += capsys.readouterr().err
    assert text in said
    return said


def test_nothing_is_shown_of_what_takes_less_than_two_seconds(capsys):
    with waiting("simulating", total=10, shown=True) as bar:
        bar.update()
        time.sleep(0.05)
        bar.print("seed 0: done")
    assert capsys.readouterr() == ("seed 0: done\n", "")


def test_nothing_is_shown_where_nobody_looks(impatient, capsys):
    with waiting("simulating", total=10) as bar:
        bar.update()
        time.sleep(0.1)
    assert capsys.readouterr().err == ""


def test_it_says_what_it_does_how_far_it_is_and_how_long_it_takes(impatient, capsys):
    with waiting("compiling the simulator", shown=True) as bar:
        assert "%" not in wait_for("compiling the simulator 00:00", capsys)
        bar.begin("simulating", total=4)
        bar.update()
        bar.note("seed 1 of 4")
        assert "left, seed 1 of 4" in wait_for("simulating  25 %", capsys)
        bar("annealing", 0.5)
        wait_for("annealing  50 %", capsys)


def test_lines_are_printed_above_the_bar(impatient, capsys):
    with waiting("simulating", total=4, shown=True) as bar:
        wait_for("simulating", capsys)
        bar.print("seed 0: done")
        assert capsys.readouterr().out == "seed 0: done\n"


def test_it_names_what_numba_compiles(impatient, capsys):
    def anneal(number):
        return number + 1

    anneal.__module__ = "qdenv.repair.anneal.moves"
    with waiting("repairing", shown=True) as bar:
        wait_for("repairing", capsys)
        assert numba.njit(anneal)(1) == 2
        bar.note("compiled")
        said = wait_for("compiled", capsys)
    assert "compiling repair.anneal, once on this machine" in said
    assert "once on this machine" not in said.rpartition("compiled")[0].rpartition("\r")[2]
