"""Experiments drawn from simulations: pieces that are made and resumed, tables by hand."""

from collections import Counter
from dataclasses import replace
from itertools import pairwise

import jax
import numpy as np
import pytest
from scipy import stats

from experiments import (
    courses,
    figure_17,
    figure_18,
    figure_19,
    figure_22,
    ledger,
    maze_success,
    runtimes,
    table_5,
)
from experiments.__main__ import make
from experiments.courses import SavedCourse
from experiments.figure_18 import SavedPeak, next_rungs
from experiments.layouts import S_EVAL, S, SavedLayout
from experiments.ledger import Case, Run
from experiments.maze_success import GROWN, SavedSuccess
from experiments.pieces import Drawn, Experiment, Folders
from experiments.published import AGENTS, TRAFFIC
from experiments.runtimes import Runtime, SavedRuntime
from experiments.table_5 import TABLE
from experiments.traffic import SavedTraffic
from qdenv.agent.evaluate import Success
from qdenv.domains.base import find_domain
from qdenv.grid import draw as draw_rows
from qdenv.io.files import write_csv
from qdenv.io.layouts import write_layout
from qdenv.simulation.maze.world import longest_path
from qdenv.stats import wilson_interval
from qdenv.study import elites as sizes
from qdenv.study.engine import run_seeds
from qdenv.types import InputError

pytestmark = pytest.mark.slow

HALL = SavedLayout("warehouse-even", "human", (9, 12))


@pytest.fixture
def folders(tmp_path, monkeypatch) -> Folders:
    """Folders without anything in them, and a zoo of the same generator in every domain."""
    for place in ("layouts", "runtimes"):
        monkeypatch.setattr(f"experiments.{place}.best_of", lambda domain, maker="nca": "the best")
    return Folders(tmp_path / "results", tmp_path / "runs")


def save(saved: SavedLayout, folders: Folders, layout: np.ndarray | None = None, **facts) -> None:
    """Save a layout as if it had been grown; the hand-made one unless given."""
    domain = find_domain(saved.domain).resized(*saved.shape)
    layout = domain.human() if layout is None else layout
    facts = dict(steps=9, changed=3, unrepaired=draw_rows(layout, domain.tiles)) | facts
    facts["origin"] = saved.origin(folders)
    write_layout(saved.path(folders), layout, domain.tiles, **facts)


def write_down(saved: SavedTraffic, folders: Folders, moved: list[float], jams: int) -> None:
    """Write runs as if they had been simulated; the last few congested."""
    (case,) = saved.cases(folders)
    known = ledger.read_runs(saved.path(folders)) if saved.path(folders).exists() else []
    rows = [
        Run(*case.key(seed), throughput, seed >= len(moved) - jams, 70, 0.5)
        for seed, throughput in enumerate(moved)
    ]
    write_csv(saved.path(folders), Run._fields, [*known, *rows])


def cells(line: str) -> list[str]:
    """Take a line of a table apart."""
    return [cell.strip() for cell in line.strip("|").split("|")]


class Made:
    """A piece that writes down that it was made; one of 99 seconds never is."""

    def __init__(self, name: str, seconds: float, *needs: "Made"):
        """Begin unmade."""
        self.name, self.kind, self.needs = name, "things", needs
        self.seconds, self.there = seconds, False

    def done(self, folders: Folders) -> float:
        """Say whether it was made."""
        return float(self.there)

    def cost(self, folders: Folders) -> float:
        """Say what it takes."""
        return 0.0 if self.there else self.seconds

    def make(self, folders: Folders) -> None:
        """Make it; all that it needs must be there."""
        assert all(piece.there for piece in self.needs)
        self.there = self.seconds != 99
        folders.results.mkdir(parents=True, exist_ok=True)
        with (folders.results / "order").open("a") as file:
            file.write(f"{self.name} ")


def test_what_a_piece_needs_is_made_before_it_once_and_only_if_the_piece_is_missing(folders):
    run = Made("run", 90)
    layout = Made("layout", 5, run)
    some, other = Made("some", 1, layout), Made("other", 2, layout)
    shown = Experiment("two", (other, some), lambda _: Drawn(None))
    assert [piece.name for piece in shown.everything] == ["run", "layout", "other", "some"]
    assert shown.ready(folders) == [run]
    make(shown, folders)
    assert (folders.results / "order").read_text().split() == ["run", "layout", "some", "other"]
    run.there, other.there = False, False
    # The layout is there: nobody needs the run that drew it.
    assert shown.missing(folders) == [other]


def test_what_is_missing_is_made_cheapest_first_and_a_piece_that_fails_is_said(folders, capsys):
    dear, cheap, never = Made("dear", 50), Made("cheap", 3), Made("never", 99)
    make(Experiment("two", (dear, cheap), lambda _: Drawn(None)), folders)
    said = capsys.readouterr().out
    first = said.index("2 pieces, about 53 s of one core: cheap")
    assert first < said.index("1 pieces") and dear.there
    with pytest.raises(InputError, match="never: was made and is still not whole"):
        make(Experiment("one", (never,), lambda _: Drawn(None)), folders)


def test_a_course_adds_up_its_runs_and_goes_on_where_it_was_left(folders, monkeypatch):
    monkeypatch.setattr(courses, "CHUNK", 2)
    saved, simulate = SavedCourse(HALL, 8, 100, 5), courses.simulate
    HALL.make(folders)
    asked: list[range] = []

    def stop_at_four(case: Case, seeds: range):
        asked.append(seeds)
        if seeds[0] == 4 and len(asked) == 3:
            raise KeyboardInterrupt
        return simulate(case, seeds)

    monkeypatch.setattr(courses, "simulate", stop_at_four)
    with pytest.raises(KeyboardInterrupt):
        saved.make(folders)
    assert saved.done(folders) == 0.8
    saved.make(folders)
    assert asked == [range(2), range(2, 4), range(4, 5), range(4, 5)]
    case, found = saved.case(folders), saved.read(folders)
    done = run_seeds(case.tiles, case.domain.simulator.tasks, case.fleet, range(5))
    rates = np.stack([run.finished for run in done.runs]).reshape(5, 2, 50).mean(axis=2)
    mean, half = found.rates
    np.testing.assert_allclose(mean, rates.mean(axis=0), rtol=1e-12)
    ends = stats.t.interval(0.95, 4, rates.mean(axis=0), stats.sem(rates, axis=0))
    np.testing.assert_allclose(mean + half, ends[1], rtol=1e-6)
    usage = np.mean([run.usage for run in done.runs], axis=0)
    np.testing.assert_allclose(found.usage / 5, usage, atol=2e-6)
    assert found.congested == sum(bool(run.congested) for run in done.runs)
    assert replace(saved, stop=True).done(folders) == 0  # other settings, other runs


# Tasks per timestep over agents: a peak at 100, and beyond it a jam.
def moved_by(agents: float) -> float:
    return agents * (2 - agents / 100) if agents < 115 else 20.0


def test_a_peak_is_located_within_five_per_cent_and_nothing_is_simulated_twice(
    folders, monkeypatch
):
    asked: list[tuple[int, int]] = []

    def simulate(case: Case, seed: int) -> Run:
        asked.append((case.agents, seed))
        return Run(*case.key(seed), moved_by(case.agents) + 0.01 * seed, False, 1000, 1.0)

    monkeypatch.setattr(ledger, "simulate", simulate)
    saved = SavedPeak(SavedLayout("warehouse-even", "human"), "peaks", 1000, 2)
    saved.layout.make(folders)
    assert saved.done(folders) == 0 and saved.read(folders) is None
    saved.make(folders)
    peak = saved.read(folders)
    assert abs(peak.agents / 100 - 1) <= 0.05
    tried = sorted({agents for agents, _ in asked})
    near = [count for count in tried if 90 < count < 115]
    assert all(more / less < 1.06 for less, more in pairwise(near))
    assert max(tried) < 100 * 1.05**12 and len(asked) == 2 * len(tried)
    assert saved.cost(folders) == 0
    saved.make(folders)
    assert len(asked) == 2 * len(tried)
    # With one run forgotten the peak is not known: of those that were there only it is simulated.
    rows = ledger.read_runs(folders.results / "traffic" / "peaks.csv")
    gone = next(row for row in rows if row.agents == peak.agents)
    write_csv(
        folders.results / "traffic" / "peaks.csv", Run._fields, [one for one in rows if one != gone]
    )
    assert saved.done(folders) < 1
    saved.make(folders)
    again = [one for one, times in Counter(asked).items() if times > 1]
    assert again == [(peak.agents, gone.seed)] and saved.read(folders).agents == peak.agents


def test_one_number_that_moves_less_by_chance_does_not_end_the_climb():
    known = {0: 1.0, 4: 2.0, 8: 1.9}
    assert next_rungs(known, 50) == [12]
    assert next_rungs(known | {12: 3.0}, 50) == [16]
    assert next_rungs(known | {12: 1.8}, 50) == [1, 2, 3, 5, 6, 7]
    assert next_rungs(known, 9) == [1, 2, 3, 5, 6, 7]  # the next one does not fit
    assert next_rungs({0: 3.0, 4: 2.0, 8: 1.0}, 50) == [-3, -2, -1, 1, 2, 3]


def test_figure_18_compares_the_peaks_that_are_located(folders, monkeypatch):
    def simulate(case: Case, seed: int) -> Run:
        moved = moved_by(case.agents * (1 if "nca" in case.layout else 1.25))
        return Run(*case.key(seed), moved, False, 1000, 1.0)

    monkeypatch.setattr(ledger, "simulate", simulate)
    for maker in figure_18.MAKERS:
        saved = figure_18.PEAKS["manufacturing", S, maker]
        save(saved.layout, folders)
        saved.make(folders)
    lines = figure_18.draw(folders).lines
    (row,) = (cells(line) for line in lines if line.startswith("| manufacturing | 33 x 36"))
    ours, theirs = (float(cell.split(", ")[1]) for cell in row[2:4])
    assert row[2].startswith("100") or row[2].startswith("99.9")
    assert row[5] == f"{100 * (ours / theirs - 1):+.0f} %" and row[4].startswith("+0 %")
    assert sum("not made yet | not made yet" in line for line in lines) == 20
    assert any("T = 1000, 3 runs" in line for line in lines)


def test_table_5_and_figure_22_follow_from_the_runs_that_are_saved(folders):
    moved = [5.0, 6.0, 7.0, 2.0]
    saved = TABLE["warehouse-even", "nca", S, "high"]
    save(saved.layout, folders)
    write_down(saved, folders, moved, jams=1)
    write_down(saved, folders, moved, jams=1)  # by a second process
    refused = TABLE["manufacturing", "cma-es", S_EVAL, "high"]
    save(refused.layout, folders, refused="no repair of 101 x 102")
    assert refused.done(folders) == 1 and refused.cost(folders) == 0 and saved.done(folders) == 0.08
    lines = table_5.draw(folders).lines
    start = "| warehouse-even | CMA-MAE + NCA, first zoo | 33"
    (row,) = (cells(line) for line in lines if line.startswith(start))
    low, high = wilson_interval(3, 4)
    error = np.std(moved[:3], ddof=1) / 3**0.5
    assert row[4:6] == [f"3/4 ({low:.0%} to {high:.0%})", f"6.000 ± {error:.3f}"]
    assert row[6:] == ["not made yet", "", "6.74 (100 %)"]
    (absent,) = (cells(line)[4:] for line in lines if "no repair of" in line)
    assert absent == 2 * ["N/A", "no repair of 101 x 102"] + ["N/A"]  # under both planners
    assert "\n".join(lines).count("not made yet") == len(TABLE) - 3
    drawn = figure_22.draw(folders)
    (row,) = (cells(line) for line in drawn.lines if "4 of 350" in line)
    assert row[3:] == ["4 of 350", "5.00", "200", "3/4"]  # the mean of all four
    (line,) = (one for axes in drawn.figure.axes for one in axes.lines if one.get_marker() == "o")
    assert list(line.get_xdata()) == [200] and line.get_ydata()[0] == 5.0
    said = [text.get_text() for axes in drawn.figure.axes for text in axes.texts]
    assert "CMA-ES + NCA: no repair found" in said


def test_a_layout_that_cannot_be_repaired_is_saved_with_the_reason(folders, monkeypatch):
    def fail(*given):
        raise InputError("no repair of 33 x 40")

    monkeypatch.setattr(sizes, "finish", fail)
    save(SavedLayout("warehouse-even", "nca"), folders)
    tiled = SavedLayout("warehouse-even", "tiled", (33, 40))
    tiled.make(folders)
    made = tiled.read(folders)
    assert tiled.done(folders) == 1 and tiled.refusal(folders) == "no repair of 33 x 40"
    assert made.layout.shape == (33, 40) and (made.layout == made.unrepaired).all()
    for piece in (SavedTraffic(tiled, "t", (9,)), SavedCourse(tiled), SavedPeak(tiled, "t", 9, 1)):
        assert piece.done(folders) == 1 and piece.cost(folders) == 0


def test_figures_17_and_19_draw_what_is_there_and_say_what_is_not(folders, monkeypatch):
    saved = figure_17.COURSES["high", "warehouse-even", "human"]
    small = replace(saved, layout=HALL, agents=8, timesteps=500, seeds=2)
    monkeypatch.setitem(figure_17.COURSES, ("high", "warehouse-even", "human"), small)
    monkeypatch.setitem(TRAFFIC, ("warehouse-even", "human", 8), "congests")
    HALL.make(folders)
    small.make(folders)
    mean = small.read(folders).rates[0]
    drawn = figure_17.draw(folders)
    (row,) = (cells(line) for line in drawn.lines if "high effort | 2 of 2" in line)
    assert row[5:7] == [f"{mean[:2].mean():.2f}", f"{mean[-2:].mean():.2f}"]
    assert sum("not made yet" in line for line in drawn.lines) == 11
    usage = figure_19.USAGE["warehouse-even", "tiled"]
    small = replace(usage, layout=HALL, agents=8, timesteps=500, seeds=2, stop=False)
    monkeypatch.setitem(figure_19.USAGE, ("warehouse-even", "tiled"), small)
    drawn = figure_19.draw(folders)
    (image,) = (axes.images[1] for axes in drawn.figure.axes if len(axes.images) == 2)
    shown, free = image.get_array(), HALL.read(folders).free
    # Against an even spread: 1 on average over the free cells, nothing on the others.
    assert shown.sum() / free.sum() == pytest.approx(1, abs=1e-3)
    assert shown.mask[~free].all()
    assert sum("not made yet" in line for line in drawn.lines) == 6


@pytest.mark.parametrize(
    ("key", "said"),
    [
        (("warehouse-even", "nca", 1400), "16.01 (90 %)"),
        (("warehouse-uneven", "tiled", 1000), "23 %"),
        (("warehouse-even", "tiled", 1400), "0 %"),
        (("manufacturing", "cma-es", 1800), "N/A"),
        (("warehouse-even", "human", 200), "congests"),
        (("manufacturing", "human", 200), "5.92"),
    ],
)
def test_what_the_paper_found_reads_as_its_tables_do(key, said):
    assert str(TRAFFIC[key]) == said and key[2] in AGENTS[key[0]].values()


def test_the_agent_is_measured_on_each_maze_once(folders, monkeypatch):
    grown = SavedLayout("maze-walls", "nca", (8, 8))
    ring = np.ones((8, 8), np.int8)
    ring[1:-1, 1:-1] = 0
    ring[2:6, 3] = 1
    save(grown, folders, ring)
    saved = SavedSuccess(grown, mazes=3, runs=20)

    way_of = jax.jit(longest_path)

    def walk(weights, maze: np.ndarray, seed: int, runs: int) -> Success:
        return Success((5 + 4 * seed) / runs, 0, 1, runs, 30.0, int(way_of(maze).length))

    monkeypatch.setattr(maze_success, "evaluate_agent", walk)
    monkeypatch.setattr(maze_success, "PIECES", (saved,))
    replace(saved, mazes=1).make(folders)
    assert saved.done(folders) == 0.5
    before = saved.read(folders)
    saved.make(folders)
    rows = saved.read(folders)
    assert rows[:2] == before and [row.maze for row in rows] == [GROWN, 0, 1, 2]
    assert {row.walls for row in rows} == {4}
    way = rows[0].shortest
    assert all(0.8 * way <= row.shortest <= 1.2 * way for row in rows)
    assert replace(saved, runs=10).done(folders) == 0
    said = cells(maze_success.draw(folders).lines[2])
    low, high = wilson_interval(5, 20)
    assert said[1] == f"25% ({low:.0%} to {high:.0%})"
    # 25, 45 and 65 %: a standard deviation of 20 %.
    assert said[4] == f"45.0 ± {20 / 3**0.5:.1f} %" and said[5] == "3"
    ring[2, 3] = 0  # another maze: what is saved belongs to the first
    save(grown, folders, ring)
    assert saved.done(folders) == 0


def test_runtimes_are_averaged_over_repairs(folders):
    saved = SavedRuntime("warehouse-even", S)
    pairs = enumerate((2.0, 4.0))
    own = ("the best",)
    rows = [Runtime(seed, 50, 1.0, 0.2, seconds, "optimal", 7, *own) for seed, seconds in pairs]
    older = rows[0]._replace(seed=2, origin="of an older generator")
    write_csv(saved.path(folders), Runtime._fields, [*rows, older])
    assert saved.read(folders) == rows and saved.done(folders) == pytest.approx(2 / 3)
    assert saved.cost(folders) == pytest.approx(1.0 + 0.2 + 3.0)
    drawn = runtimes.draw(folders)
    row = cells(drawn.lines[2])
    assert row[:3] == ["warehouse-even", "33 x 36", "50"]
    assert row[5:] == ["3.00 ± 1.00", "2", "7", "optimal"]
    assert drawn.lines[-1] == "Not made yet: 22 of 23."


def test_runtimes_are_those_of_repairs_as_in_a_search(folders, small_run, monkeypatch):
    monkeypatch.setattr(runtimes, "open_generator", lambda domain, maker: small_run)
    saved = SavedRuntime("warehouse-even", (14, 13), seeds=2)
    saved.make(folders)
    rows = saved.read(folders)
    assert [row.seed for row in rows] == [0, 1]
    for row in rows:
        grown = sizes.grow_elite(small_run, "best", (14, 13))
        how = small_run.config.evaluation.repair
        sized = sizes.finish(grown._replace(repair=how), row.seed)
        assert (row.steps, row.repair, row.changed) == (sized.steps, sized.repair, sized.changed)
        assert min(row.grow_seconds, row.compile_seconds) > 0 and row.changed > 0
    assert saved.done(folders) == 1 and saved.cost(folders) == 0
