"""What the progress bar says while nothing moves."""

import time

import jax
import numba
import pytest
import toy

from qdenv.pipeline import make_pipeline
from qdenv.run import progress
from qdenv.run.progress import Progress


@pytest.fixture(autouse=True)
def quick_ticks(monkeypatch):
    monkeypatch.setattr(progress, "TICK", 0.01)


def wait_for(text, capsys):
    """Read what is written until it holds `text`, for ten seconds at most."""
    said, end = "", time.perf_counter() + 10
    while text not in said and time.perf_counter() < end:
        time.sleep(0.01)
        said += capsys.readouterr().err
    return said


def test_it_names_what_is_compiled_until_the_first_evaluations_are_done(capsys):
    pipeline = make_pipeline(toy.CONFIG.evaluation)
    with Progress(8, True) as shown:
        shown.begin(0)
        watched = shown.over_pipeline(pipeline)
        jax.eval_shape(watched.grow, jax.ShapeDtypeStruct((2, pipeline.solution_size), float))
        said = wait_for("compiling and running the generator and repair: 0 s", capsys)
        assert "compiling and running the generator and repair: 0 s" in said

        def anneal(number):
            return number + 1

        anneal.__module__ = "qdenv.repair.anneal.moves"
        assert numba.njit(anneal)(1) == 2
        said = wait_for("compiling repair.anneal, once on this machine", capsys)
        assert "compiling repair.anneal, once on this machine" in said

        shown.advance(1)
        shown.advance(1)
        shown.update(4, "QD-score 3")
        assert "4/8" in wait_for("QD-score 3", capsys)
        time.sleep(0.05)
        capsys.readouterr()
        time.sleep(0.05)
        assert not capsys.readouterr().err  # it ticks no more


def test_it_says_what_a_search_does_between_iterations_and_then_how_it_stands(capsys):
    with Progress(8, True) as shown:
        shown.begin(0)
        with shown.during("the search thinks"):
            time.sleep(0.05)  # before the first evaluations are done others speak
        assert "the search thinks" not in capsys.readouterr().err
        shown.update(4, "QD-score 3")
        with shown.during("the search thinks"):
            assert "the search thinks: 0 s" in wait_for("the search thinks: 0 s", capsys)
        shown.update(2, "QD-score 4")
        assert "QD-score 4" in wait_for("QD-score 4", capsys)
        time.sleep(0.05)
        assert "thinks" not in capsys.readouterr().err


def test_it_shows_nothing_unless_asked(capsys):
    with Progress(8, False) as shown:
        shown.begin(4)
        time.sleep(0.05)
        shown.update(4, "QD-score 3")
    assert capsys.readouterr().err == ""


def test_what_is_left_is_reckoned_without_the_compilation(monkeypatch):
    now = [1000.0]
    monkeypatch.setattr(progress.time, "time", lambda: now[0])
    with Progress(600, True) as shown:
        shown.begin(0)
        bar = shown._bar
        bar._time, bar.start_t, bar.last_print_t = progress.time.time, now[0], now[0]
        now[0] += 36  # compiling
        for _ in range(50):
            shown.advance(1)
            now[0] += 0.125
        shown.update(50, "QD-score 3")
        drawn = bar.format_dict
        assert drawn["elapsed"] == pytest.approx(6.25)
        assert drawn["n"] / drawn["elapsed"] == pytest.approx(8)
        assert "00:06<01:08,  8.00eval/s" in str(bar)
