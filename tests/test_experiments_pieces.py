"""The experiments by name: made once, drawn from what is saved, listed with their costs."""

import re
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from experiments import __main__ as command
from experiments import figure_16, figure_20, figure_21, table_4
from experiments.__main__ import find, names
from experiments.layouts import SavedLayout
from experiments.panels import FIGURES, Panel, panels_of
from experiments.pieces import RESULTS, Experiment, Folders
from experiments.published import TABLE_4
from experiments.runs import SavedRun, read_summary, summarise
from qdenv.configurations import PRESETS
from qdenv.io.files import write_csv
from qdenv.io.records import read_rows
from qdenv.ops.costs import cpu_seconds
from qdenv.run.directory import RunDirectory
from qdenv.types import InputError

pytestmark = pytest.mark.slow


@pytest.fixture
def folders(small_run, tmp_path, monkeypatch) -> Folders:
    """Folders of results, without any, and of the small run as if it were a preset's."""
    monkeypatch.setitem(PRESETS, "warehouse-even", small_run.config)
    return Folders(tmp_path / "results", small_run.path.parent)


def test_every_script_of_a_figure_or_table_is_an_experiment_that_says_what_it_shows():
    assert {"figure_06", "figure_16", "figure_20", "table_4"} <= set(names())
    for name in names():
        found = find(name)
        assert isinstance(found, Experiment) and found.pieces, name
        kind, _, number = name.partition("_")
        if number.isdecimal() and name not in FIGURES:
            title = sys.modules[f"experiments.{name}"].__doc__
            assert title.startswith(f"{kind.capitalize()} {int(number)}: "), name


def test_what_ships_is_redrawn_to_the_tables_that_ship(tmp_path):
    folders, redrawn = Folders(RESULTS, tmp_path), set()
    for name in names():
        found = find(name)
        if found.drawable(folders):
            drawn = found.draw(folders)
            assert drawn.figure is not None or drawn.lines
            if drawn.lines:
                shipped = (RESULTS / f"{name}.md").read_text()
                assert "\n".join(drawn.lines) + "\n" == shipped, name
                redrawn.add(name)
    assert redrawn == {path.stem for path in RESULTS.glob("*.md")}


def test_a_summary_holds_the_numbers_of_the_archive(small_run, tmp_path):
    summarise(small_run, tmp_path / "kept")
    kept, columns = read_summary(tmp_path / "kept"), small_run.archive.columns
    order = np.argsort(columns["index"])
    assert kept.config == small_run.config and kept.measures == small_run.measures
    assert kept.metrics == small_run.read_metrics()
    np.testing.assert_array_equal(kept.elites["cell"], columns["index"][order])
    for name, values in {
        "objective": columns["objective"],
        "environment entropy": columns["measures"][:, 1],
        "throughput": columns["throughput"].mean(axis=1),
        "success": (~columns["congested"]).mean(axis=1),
        "changed": [
            sum(a != b for a, b in zip(one.ravel(), other.ravel(), strict=True))
            for one, other in zip(columns["unrepaired"], columns["repaired"], strict=True)
        ],
    }.items():
        np.testing.assert_allclose(kept.elites[name], np.asarray(values)[order], rtol=1e-5)
    grid = kept.objectives
    assert grid.shape == (25,) and np.isfinite(grid).sum() == len(columns["index"])
    assert np.nansum(grid) == pytest.approx(kept.last.qd_score, rel=1e-5)
    kept = RunDirectory.open(tmp_path / "kept").archive.columns["solution"]
    np.testing.assert_array_equal(kept, columns["solution"])  # fewer than `BEST`


def test_a_run_is_made_once_and_goes_on_where_it_was_left(folders, monkeypatch):
    run = SavedRun("warehouse-even")
    monkeypatch.setattr("qdenv.train", None)  # the folder holds it: nobody may begin it anew
    assert run.done(folders) == 0 and run.cost(folders) == 0
    run.make(folders)
    assert run.done(folders) == 1 and run.cost(folders) == 0
    kept = run.path(folders) / "metrics.csv"
    kept.write_text(kept.read_text().replace("\n1,6,", "\n1,3,"))
    read_summary.cache_clear()
    assert run.done(folders) == 0.5
    run.make(folders)
    assert run.done(folders) == 1
    more = replace(run, evaluations=12)
    assert more.done(folders) == 0.5
    assert more.cost(folders) == pytest.approx(6 * cpu_seconds(more.config))
    with pytest.raises(InputError, match="other settings"):
        config = replace(PRESETS["warehouse-even"], archive=())
        monkeypatch.setitem(PRESETS, "warehouse-even", config)
        run.make(folders)


def test_tables_and_pictures_of_archives_say_what_is_run_and_what_not(folders, small_run):
    SavedRun("warehouse-even").make(folders)
    last = small_run.read_metrics()[-1]
    lines = table_4.draw(folders).lines
    own = [cell.strip() for cell in lines[2].split("|")]
    assert own[1:5] == ["warehouse-even", "cma-mae", "1", "6"]
    assert float(own[5]) == pytest.approx(last.qd_score, abs=0.51)
    assert own[8] == "20,366 ± 653, 0.33" and float(own[9]) == round(last.qd_score / 20366, 2)
    absent = [line for line in lines if "not run" in line]
    assert len(absent) == len(TABLE_4) - 1
    regular = (small_run.archive.columns["measures"][:, 1] < 0.5).sum()
    row = [cell.strip() for cell in figure_16.draw(folders).lines[2].split("|")]
    assert row[1:6] == ["warehouse-even", "5", "6", str(round(25 * last.coverage)), str(regular)]
    for script in (figure_16, figure_20, figure_21):
        assert script.draw(folders).figure.axes


def test_several_seeds_are_averaged_with_their_standard_error(folders, small_run):
    run = SavedRun("warehouse-even")
    run.make(folders)
    kept = folders.results / "runs" / "warehouse-even"
    other = folders.results / "runs" / "warehouse-even-seed1"
    other.mkdir()
    for file in kept.iterdir():
        (other / file.name).write_bytes(file.read_bytes())
    rows = list(read_rows(other / "metrics.csv"))
    rows[-1]["qd_score"] = str(float(rows[-1]["qd_score"]) + 100)
    write_csv(other / "metrics.csv", list(rows[0]), [list(row.values()) for row in rows])
    own = [cell.strip() for cell in table_4.draw(folders).lines[2].split("|")]
    mean, error = (float(number) for number in own[5].split(" ± "))
    assert own[3] == "2"
    assert mean == pytest.approx(small_run.read_metrics()[-1].qd_score + 50, abs=0.51)
    assert error == 50  # of two values that differ by 100


def test_layouts_are_drawn_once_and_shown_with_what_the_repair_changed(folders):
    hall = SavedLayout("warehouse-even", "human", (13, 16))
    absent = SavedLayout("warehouse-even", "cma-es", (13, 16))
    shown = panels_of("halls", (Panel("by hand", hall), Panel("searched", absent)))
    assert not shown.drawable(folders) and hall.done(folders) == 0
    hall.make(folders)
    made = hall.read(folders)
    assert shown.missing(folders) == [absent.run(), absent] and shown.drawable(folders)
    assert made.layout.shape == (13, 16) and (made.layout == made.unrepaired).all()
    assert made.domain.numbers == {"shelves": int((made.layout == 1).sum())}
    drawn = shown.draw(folders)
    assert "| warehouse-even | human | 13 x 16 |  | 0 |  |" in drawn.lines
    assert [axes.get_title() for axes in drawn.figure.axes] == ["by hand", ""]
    with pytest.raises(InputError, match="not saved yet"):
        absent.read(folders)


def test_the_command_draws_lists_and_refuses(folders, capsys, tmp_path):
    SavedRun("warehouse-even").make(folders)
    where = dict(runs=folders.runs, results=folders.results, out=tmp_path / "out")
    command.main(("table_4", "figure_20"), **where)
    said = capsys.readouterr().out
    assert (tmp_path / "out" / "table_4.md").read_text() in said
    assert imread(tmp_path / "out" / "figure_20.png").ndim == 3
    command.main((), **where)
    said = capsys.readouterr().out
    assert "table_4       QD-score and coverage of all algorithms: 1 of " in said
    missing = said.partition("table_4 ")[2].splitlines()[1]
    assert re.search(r"missing, .* searches: \d+ \(\d+ (min|h)\)$", missing)
    command.main((), **where, missing="table_4")
    said = capsys.readouterr().out.splitlines()
    assert any(line.startswith("run warehouse-even-map-elites: about ") for line in said)
    assert not any(line.startswith("run warehouse-even:") for line in said)
    command.main((), **where, missing="table_4", seeds=3)
    said = capsys.readouterr().out
    assert "run warehouse-even-seed2: about " in said and "warehouse-even-seed3" not in said
    with pytest.raises(InputError, match="nothing is saved to draw from"):
        command.main(("figure_14",), **where)
    with pytest.raises(InputError, match=r"unknown experiment.*figure_99"):
        command.main(("figure_99",), **where)


def start(*arguments: str) -> subprocess.Popen:
    """Start the command as people do."""
    return subprocess.Popen(
        [sys.executable, "-m", "experiments", *arguments],
        cwd=Path(__file__).parents[1],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def test_whoever_has_read_enough_closes_the_list_in_peace():
    with start("--results", "nowhere") as listing:
        listing.stdout.close()
        assert listing.stderr.read() == "" and listing.wait() == 0


def test_an_interruption_says_how_to_go_on(tmp_path):
    arguments = ("--make", "runtimes", "--results", str(tmp_path))
    making = start(*arguments)
    assert "pieces, about" in making.stdout.readline()
    making.send_signal(signal.SIGINT)
    _, err = making.communicate()
    assert making.returncode == 130
    assert err.strip() == f"qdenv: stopped; `python -m experiments {' '.join(arguments)}` goes on"
