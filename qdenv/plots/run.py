"""The pictures of a run: its archive, its best layout, its progress."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from qdenv.plots.archive import save_heatmap, scatter_objectives
from qdenv.plots.figure import new_figure, save_figure
from qdenv.plots.layouts import draw_layout
from qdenv.plots.notes import save_notes
from qdenv.training.notes import NOTES, read_notes
from qdenv.training.records import RunDirectory
from qdenv.types import InputError

MARK = "#e8590c"
MARKERS = {"start": "o", "goal": "*"}  # any other mark is a square


def plot_run(run: RunDirectory | str | Path, folder: Path | None = None) -> list[Path]:
    """Draw archive.png, progress.png and best_layout.png of a run.

    And notes.png, where its algorithm says anything of itself.

    Args:
        run: the run, or its folder.
        folder: where to; the run's own unless given.

    Returns:
        the pictures that could be drawn: none of an empty archive's layout.

    Raises:
        InputError: the run has saved no archive yet, a file of it is damaged, or it ships with the
            package and no other folder is given.
    """
    run = run if isinstance(run, RunDirectory) else RunDirectory.open(run)
    if folder is None:
        run.demand_own()
    place = folder or run.path
    archive, meaning = run.load_archive(), run.meaning
    pictures = [place / "archive.png", place / "progress.png"]
    objectives = scatter_objectives(archive["index"], archive["objective"], meaning.measures)
    save_heatmap(pictures[0], objectives, meaning.measures, label=meaning.objective)
    save_progress(pictures[1], run)
    notes = read_notes(run.path / NOTES)
    if notes:
        pictures.append(place / "notes.png")
        save_notes(pictures[-1], notes)
    best = run.read_best_layout()
    if best is not None:
        pictures.append(place / "best_layout.png")
        axes = draw_layout(best.layout, meaning.tiles, names=meaning.names)
        draw_marks(axes, best.marks)
        figure = axes.get_figure()
        assert isinstance(figure, Figure)
        save_figure(figure, pictures[-1], crop=True)
    return pictures


def draw_marks(axes: Axes, marks: Mapping[str, tuple[int, int]]) -> None:
    """Mark named cells (row, column) on a drawn layout, with their names beside them."""
    rows, _ = np.array(axes.get_ylim())
    for name, (row, column) in marks.items():
        axes.scatter(
            column, row, s=42, color=MARK, marker=MARKERS.get(name, "s"), edgecolors="white", lw=0.6
        )
        above = row > rows / 2
        axes.annotate(
            name,
            (column, row),
            xytext=(0, 6 if above else -6),
            textcoords="offset points",
            ha="center",
            va="bottom" if above else "top",
            fontsize=7,
            color=MARK,
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6, "alpha": 0.85},
        )


def save_progress(path: Path, run: RunDirectory) -> None:
    """Draw QD-score, coverage and best objective over evaluations (Figure 20).

    Raises:
        InputError: no iteration is finished.
    """
    rows = run.read_metrics()
    if not rows:
        raise InputError(f"{run.path}/metrics.csv: no iteration is finished, there is no progress")
    figure = new_figure(9, 2.6, dpi=120)
    panels = {"QD-score": "qd_score", "coverage": "coverage", "best objective": "best_objective"}
    evaluations = [row.evaluations for row in rows]
    for axes, (title, column) in zip(figure.subplots(1, 3), panels.items(), strict=True):
        values = [getattr(row, column) for row in rows]
        # A line through one point is nothing: the last point is marked.
        axes.plot(evaluations, values, marker="o", markersize=4, markevery=[len(rows) - 1])
        axes.set(title=title, xlabel="evaluations", ymargin=0.1)
        axes.set_ylim(bottom=min(0, *values))
        axes.spines[["top", "right"]].set_visible(False)
    axes.set_ylabel(run.meaning.objective, fontsize="small")
    save_figure(figure, path)
