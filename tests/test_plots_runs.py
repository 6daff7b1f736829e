"""Several runs side by side: repetitions together, what differs in words, one colour scale."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import toy
from scipy import stats

from qdenv.cli.main import run as qdenv
from qdenv.io.files import write_csv
from qdenv.run import loop
from qdenv.run.directory import METRICS, Metrics, RunDirectory
from qdenv.study.groups import band_of, group_runs, tell_apart
from qdenv.types import Measure
from qdenv.view.runs import draw_archives, draw_progress

pytestmark = pytest.mark.slow

GRID = (Measure("x", 0, 4, 4), Measure("y", 0, 3, 3))


@pytest.fixture(scope="module")
def runs(tmp_path_factory) -> list[RunDirectory]:
    """Three runs that differ in their seeds, and one that differs in alpha."""
    folder = tmp_path_factory.mktemp("runs")
    first = loop.train(replace(toy.CONFIG, evaluations=24), folder / "a", progress=False)
    copies = []
    for seed in (1, 2):
        shutil.copytree(first.path, folder / f"b{seed}")
        copies.append(RunDirectory(folder / f"b{seed}"))
        repair = replace(first.config.evaluation.repair, workers=seed)  # which changes no result
        evaluation = replace(first.config.evaluation, repair=repair)
        copies[-1].write_config(replace(first.config, seed=seed, evaluation=evaluation))
        rows = [row._replace(qd_score=row.qd_score + seed) for row in first.read_metrics()]
        write_csv(copies[-1].path / METRICS, Metrics._fields, rows[: len(rows) - seed + 1])
    shutil.copytree(first.path, folder / "c")
    other = RunDirectory(folder / "c")
    evaluation = replace(first.config.evaluation, alpha=first.config.evaluation.alpha + 1)
    other.write_config(replace(first.config, evaluation=evaluation))
    return [first, *copies, other]


def test_runs_that_differ_by_chance_alone_are_one_group(runs):
    same, other = group_runs(runs)
    assert [run.config.seed for run in same.runs] == [0, 1, 2] and other.runs == (runs[3],)
    alphas = [run.config.evaluation.alpha for run in (runs[0], runs[3])]
    assert [same.label, other.label] == [f"alpha {alpha:g}" for alpha in alphas]
    assert same.title == f"{same.label} (seeds 0, 1, 2)" and other.title.endswith(" (seed 0)")
    shortest = runs[2].read_metrics()
    assert same.evaluations.tolist() == [row.evaluations for row in shortest]
    first = np.array([row.qd_score for row in runs[0].read_metrics()])[: len(shortest)]
    np.testing.assert_allclose(same.curves["qd_score"], first + np.arange(3)[:, None])


def test_bands_are_the_mean_and_students_interval():
    values = np.array([[1.0, 2.0], [2.0, 2.0], [6.0, 2.0]])
    mean, half = band_of(values)
    low, high = stats.t.interval(0.95, 2, loc=3, scale=values[:, 0].std(ddof=1) / 3**0.5)
    assert mean.tolist() == [3, 2]
    np.testing.assert_allclose(half, [(high - low) / 2, 0])
    assert np.isnan(band_of(values[:1])[1]).all()


def settings(algorithm, domain="warehouse-even", **more):
    return {"algorithm.name": algorithm, "evaluation.domain.name": domain, **more}


def test_labels_say_who_searches_where_and_what_else_differs():
    one = settings("cma-mae", **{"algorithm.batch": 10, "evaluation.alpha": 5.0})
    assert tell_apart([one]) == ["CMA-MAE"]
    others = [one, settings("map-elites", **{"evaluation.alpha": 5.0}), settings("dsage")]
    assert tell_apart(others) == ["CMA-MAE", "MAP-Elites", "DSAGE"]
    assert tell_apart([one, {**one, "evaluation.alpha": 1.0}]) == ["alpha 5", "alpha 1"]
    both = [one, {**one, "algorithm.batch": 30}, settings("random", **{"evaluation.alpha": 5.0})]
    assert tell_apart(both) == ["CMA-MAE, batch 10", "CMA-MAE, batch 30", "random search"]
    places = [one, {**one, "evaluation.domain.name": "manufacturing"}]
    assert tell_apart(places) == ["warehouse-even", "manufacturing"]


def test_progress_has_a_line_per_group_and_a_band_for_several_runs(runs):
    figure = draw_progress(group_runs(runs), "petals")
    left, middle, right = figure.axes
    assert [axes.get_title() for axes in figure.axes] == ["QD-score", "coverage", "best objective"]
    assert len(left.lines) == 2 and len(left.collections) == 1
    mean = band_of(group_runs(runs)[0].curves["qd_score"])[0]
    np.testing.assert_allclose(left.lines[0].get_ydata(), mean)
    assert right.get_ylabel() == "petals" and middle.get_xlabel() == "evaluations"
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == [g.title for g in group_runs(runs)]
    alone = draw_progress(group_runs(runs[:1]), "petals", 3.5)
    assert not alone.legends and not alone.axes[0].collections
    assert len({axes.get_position().x0 for axes in alone.axes}) == 1  # one below the other


def test_archives_share_one_colour_scale_and_one_bar():
    values = {"a": np.linspace(1, 2, 12), "b": np.full(12, np.nan), "c": np.linspace(5, 9, 12)}
    shown = [(title, objectives, GRID) for title, objectives in values.items()]
    figure = draw_archives(shown, "petals")
    images = [axes.images[0] for axes in figure.axes[:3]]
    assert {image.get_clim() for image in images} == {(1.0, 9.0)}
    assert figure.axes[3].get_xlabel() == "petals" and len(figure.axes) == 4
    assert [axes.get_title() for axes in figure.axes[:3]] == [
        "a\n100.0% filled", "b\n0.0% filled", "c\n100.0% filled",
    ]  # fmt: skip


def test_plot_draws_several_runs_into_a_folder_in_the_format_that_is_asked_for(
    runs, folder, capsys
):
    paths = [str(run.path) for run in runs]
    assert qdenv(["plot", *paths]) == 0
    said = capsys.readouterr().out.splitlines()
    first = runs[2].read_metrics()[-1]
    assert said[0].startswith(f"{group_runs(runs)[0].title}: QD-score ")
    assert said[0].endswith(f" after {first.evaluations} evaluations") and " +- " in said[0]
    assert " +- " not in said[1] and said[-2:] == ["plots/archives.png", "plots/progress.png"]
    assert qdenv(["plot", *paths, "--format", "svg", "--width", "column"]) == 0
    assert sorted(path.name for path in Path("plots-2").iterdir()) == [
        "archives.svg", "progress.svg",
    ]  # fmt: skip
    assert 'width="252pt"' in Path("plots-2/progress.svg").read_text()
    assert qdenv(["plot", paths[0], "--out", "one", "--format", "pdf"]) == 0
    assert {path.suffix for path in Path("one").iterdir()} == {".pdf"}
