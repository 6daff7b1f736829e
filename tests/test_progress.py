"""What the bar shows of a long task."""

import io
import threading
import time

import numba
import pytest
import tqdm.std

from qdenv import progress
from qdenv.cli import main
from qdenv.ops.output import say
from qdenv.progress import Bar


@pytest.fixture
def quick(monkeypatch):
    """Show a bar after a hundredth of a second, and redraw it as often."""
    for name in ("_PATIENCE", "_TICK", "_FILE_TICK"):
        monkeypatch.setattr(progress, name, 0.01)


def wait_for(text, capsys):
    """Read what is shown until it contains `text`, for a minute at most; return all of it."""
    shown, end = "", time.monotonic() + 60
    while text not in shown and time.monotonic() < end:
        time.sleep(0.01)
        shown += capsys.readouterr().err
    assert text in shown
    return shown


def test_a_short_task_shows_nothing(monkeypatch, capsys):
    monkeypatch.setattr(progress, "_PATIENCE", 1000.0)
    with Bar("simulating", total=10, shown=True) as bar:
        bar.update()
        time.sleep(0.05)
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize("options", [{}, {"shown": False, "unit": "eval"}])
def test_nothing_is_shown_without_a_terminal_or_where_it_is_switched_off(quick, capsys, options):
    with Bar("simulating", total=10, **options) as bar:
        bar.update()
        time.sleep(0.1)
    assert capsys.readouterr().err == ""


def test_step_share_and_time_left_are_shown(quick, capsys):
    with Bar("compiling the simulator", shown=True) as bar:
        assert "%" not in wait_for("compiling the simulator 00:00", capsys)
        bar.begin("simulating", total=4)
        bar.update()
        bar.note("seed 1 of 4")
        assert "left, seed 1 of 4" in wait_for("simulating  25 %", capsys)
        bar("annealing", 0.5)
        wait_for("annealing  50 %", capsys)


def test_a_reader_that_leaves_stops_the_bar_alone(quick, monkeypatch):
    class Closed(io.StringIO):
        def write(self, text):
            raise BrokenPipeError

    monkeypatch.setattr("sys.stderr", Closed())
    with Bar("simulating", total=4, shown=True, unit="eval"):
        time.sleep(0.1)
    line = io.StringIO()
    printing = threading.Thread(target=tqdm.std.tqdm.write, args=("a line", line), daemon=True)
    printing.start()
    printing.join(10)
    assert line.getvalue() == "a line\n"


def test_lines_are_printed_above_the_bar(quick, capsys):
    with main._printing(), Bar("simulating", total=4, shown=True):
        wait_for("simulating", capsys)
        say("seed 0: done")
        assert capsys.readouterr().out == "seed 0: done\n"


def test_functions_that_numba_compiles_are_named_meanwhile(quick, capsys):
    def anneal(number):
        return number + 1

    anneal.__module__ = "qdenv.repairs.anneal.moves"
    with Bar("repairing", shown=True) as bar:
        wait_for("repairing", capsys)
        assert numba.njit(anneal)(1) == 2
        bar.note("compiled")
        shown = wait_for("compiled", capsys)
    assert "compiling repairs.anneal, once on this machine" in shown
    assert "once on this machine" not in shown.rpartition("compiled")[0].rpartition("\r")[2]


def test_a_bar_with_a_unit_shows_what_it_waits_for_and_stays(quick, capsys):
    with Bar("", 8, True, unit="eval") as bar:
        bar.wait_for("compiling and running the simulator")
        wait_for("0/8 [00:00<?, ?eval/s, compiling and running the simulator: 0 s]", capsys)
        bar.update(4)
        bar.note("QD-score 3")
        assert "compiling" not in wait_for("QD-score 3", capsys).rpartition("4/8")[2]
        with bar.waiting_for("the search prepares the next population"):
            wait_for("the search prepares the next population: 0 s", capsys)
        wait_for("QD-score 3", capsys)
        bar.update(4)
    assert capsys.readouterr().err.rpartition("\r")[2].strip().startswith("100%")


def test_the_time_left_is_estimated_without_the_compilation(quick, monkeypatch, capsys):
    now = [1000.0]
    for module in (progress.time, tqdm.std):
        monkeypatch.setattr(module, "time", lambda: now[0])
    with Bar("", 600, True, unit="eval") as bar:
        now[0] += 36  # compiling
        for _ in range(50):
            bar.update()
            now[0] += 0.125
        assert wait_for("50/600 [00:06<01:08,  8.00eval/s]", capsys)
