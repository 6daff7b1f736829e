"""The pictures of a run: its archive, its best layout, its progress."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from qdenv.plots.archive import save_heatmap, scatter_objectives
from qdenv.plots.figure import save_figure
from qdenv.plots.layouts import draw_layout
from qdenv.plots.notes import save_notes
from qdenv.plots.runs import Shown, draw_archives, draw_progress
from qdenv.plots.widths import PAGE
from qdenv.run.directory import RunDirectory
from qdenv.run.log import NOTES, read_notes
from qdenv.study.groups import group_runs

MARK = "#e8590c"
MARKERS = {"start": "o", "goal": "*"}  # any other mark is a square


def plot_run(
    run: RunDirectory | str | Path,
    folder: Path | None = None,
    form: str = "png",
    width: float | None = None,
) -> list[Path]:
    """Draw archive.png, progress.png and best_layout.png of a run.

    And notes.png, where its algorithm says anything of itself.

    Args:
        run: the run, or its folder.
        folder: where to; the run's own unless given.
        form: ending of the pictures: png, svg or pdf.
        width: of archive and progress in inches; what suits a screen unless given.

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
    meaning = run.meaning
    pictures = [place / f"archive.{form}", place / f"progress.{form}"]
    size: Any = {} if width is None else {"width": width}
    save_heatmap(pictures[0], _objectives(run), meaning.measures, label=meaning.objective, **size)
    save_progress(pictures[1], run, **size)
    notes = read_notes(run.path / NOTES)
    if notes:
        pictures.append(place / f"notes.{form}")
        save_notes(pictures[-1], notes)
    best = run.read_best_layout()
    if best is not None:
        pictures.append(place / f"best_layout.{form}")
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


def save_progress(path: Path, run: RunDirectory, width: float = PAGE) -> None:
    """Draw QD-score, coverage and best objective over evaluations (Figure 20).

    Raises:
        InputError: no iteration is finished.
    """
    save_figure(draw_progress(group_runs([run]), run.meaning.objective, width), path)


def plot_runs(
    runs: Sequence[RunDirectory], folder: Path, form: str = "png", width: float = PAGE
) -> list[Path]:
    """Draw the archives of several runs on one colour scale, and their progress by groups.

    Args:
        runs: of one objective.
        folder: where to.
        form: ending of the pictures: png, svg or pdf.
        width: in inches.

    Raises:
        InputError: see `groups.group_runs`; or an archive has more than two measures.
    """
    groups, objective = group_runs(runs), runs[0].meaning.objective
    pictures = [folder / f"archives.{form}", folder / f"progress.{form}"]
    shown = [
        Shown(group._replace(runs=(run,)).title, _objectives(run), run.measures)
        for group in groups
        for run in group.runs
    ]
    save_figure(draw_archives(shown, objective, width), pictures[0])
    save_figure(draw_progress(groups, objective, width), pictures[1])
    return pictures


def _objectives(run: RunDirectory) -> np.ndarray:
    """Read the objectives of all cells of a run's archive, float [C], NaN where empty."""
    archive = run.load_archive()
    return scatter_objectives(archive["index"], archive["objective"], run.measures)
