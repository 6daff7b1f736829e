"""Pictures of runs: archives, progress over evaluations, the best layout, a surrogate's errors."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from textwrap import wrap
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter, StrMethodFormatter

from qdenv.run.directory import RunDirectory
from qdenv.run.log import NOTES, Note, read_notes
from qdenv.study.groups import CURVES, Group, band_of, group_runs
from qdenv.types import Measure
from qdenv.view.archive import draw_heatmap, save_heatmap, scatter_objectives
from qdenv.view.layouts import draw_layout
from qdenv.view.style import (
    DASHES,
    GREY,
    PALETTE,
    SCREEN_DPI,
    SMALL,
    add_legend,
    new_figure,
    save_figure,
    styled,
)
from qdenv.view.widths import PAGE

_SKIPPED = ("iteration", "evaluations", "fits")  # counters, of which a curve shows nothing
_LOGARITHMIC = ("loss", "rmse")  # what shrinks by factors
_LOWEST_R2 = -1.0  # further down it says no more than "bad"
_COLUMNS = 4


@styled
def _draw_notes(notes: list[Note]) -> Figure:
    """Draw one panel for each kind of number: ``loss_repair`` and ``loss_usage`` are of one kind.

    Args:
        notes: one per iteration, at least one.
    """
    kinds: dict[str, list[str]] = {}
    for name in notes[0]:
        if name not in _SKIPPED:
            kinds.setdefault(name.partition("_")[0], []).append(name)
    rows = -(-len(kinds) // _COLUMNS)
    figure = new_figure(10, 3.4 * rows, dpi=SCREEN_DPI)
    panels = figure.subplots(rows, _COLUMNS, squeeze=False).ravel()
    evaluations = [note["evaluations"] for note in notes]
    for axes, (kind, names) in zip(panels, kinds.items(), strict=False):
        for name in names:
            label = name.removeprefix(f"{kind}_").replace("_", " ")
            axes.plot(evaluations, [note[name] for note in notes], ".-", label=label, lw=1)
        axes.set(title=kind if len(names) > 1 else names[0].replace("_", " "))
        axes.set_xlabel("true evaluations")
        if kind in _LOGARITHMIC:
            axes.set_yscale("log")
        if kind == "r2":
            axes.set_ylim(_LOWEST_R2, 1)
        if len(names) > 1:
            # Below the panel: inside, it would cover the curves.
            place = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.2), "ncols": 2}
            axes.legend(fontsize="x-small", frameon=False, **place)
    for axes in panels[len(kinds) :]:
        axes.set_visible(False)
    return figure


_NARROWEST = 1.65  # inches of one archive
_ABREAST = 5.0  # inches from which the panels of progress stand side by side
_TALL = 0.85  # of its width: the height of a panel
_FLAT = 0.5  # likewise of one in a column
_TITLES = 0.55  # inches above and below it
_LETTERS_PER_INCH = 12  # of a label
_MEANING = "lines: mean over runs, bands: its 95 % interval"


class ArchivePanel(NamedTuple):
    """One archive."""

    title: str  # whose
    objectives: np.ndarray  # float [C], row-major, not finite where a cell is empty
    measures: Sequence[Measure]  # its axes


@styled
def draw_progress(groups: Sequence[Group], objective: str, width: float = PAGE) -> Figure:
    """Draw QD-score, coverage and best objective over evaluations (Figure 20).

    A line for each group, the mean of its runs, with a band where there are several.

    Args:
        groups: of runs.
        objective: what is maximised, with its unit.
        width: in inches; on narrow paper the panels stand one below the other.
    """
    shape = (1, 3) if width >= _ABREAST else (3, 1)
    tall = _TALL if shape[0] == 1 else _FLAT
    figure = new_figure(width, shape[0] * (tall * width / shape[1] + _TITLES))
    panels = figure.subplots(*shape, sharex=True).ravel()
    for axes, (name, title) in zip(panels, CURVES.items(), strict=True):
        for place, group in enumerate(groups):
            _draw_curve(axes, group, name, place)
        axes.set(title=title, ymargin=0.1)
        if name != "best_objective":  # which hardly moves, seen from zero
            lowest = min(float(group.curves[name].min()) for group in groups)
            axes.set_ylim(bottom=min(0.0, lowest))
        axes.grid()
        if name == "coverage":
            axes.yaxis.set_major_formatter(PercentFormatter(1.0))
        axes.locator_params(axis="x", nbins=4)
        axes.xaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
    panels[-1].set_ylabel(objective, fontsize=SMALL)
    for axes in panels if shape[0] == 1 else panels[-1:]:
        axes.set_xlabel("evaluations")
    if len(groups) > 1:
        add_legend(figure, *panels[0].get_legend_handles_labels())
    if any(len(group.runs) > 1 for group in groups):
        figure.supxlabel(_MEANING, fontsize=SMALL, color=GREY)
    return figure


def _draw_curve(axes: Axes, group: Group, name: str, place: int) -> None:
    """Draw the mean of a group's runs, and its interval where it has one."""
    (mean, half), colour = band_of(group.curves[name]), PALETTE[place % len(PALETTE)]
    dashes = DASHES[place // len(PALETTE) % len(DASHES)]
    # A line through one point is nothing: the last point is marked.
    look: Any = {"marker": "o", "markevery": [len(mean) - 1], "linestyle": dashes}
    axes.plot(group.evaluations, mean, color=colour, label=group.title, **look)
    if len(group.runs) > 1:
        axes.fill_between(
            group.evaluations, mean - half, mean + half, color=colour, alpha=0.2, lw=0
        )


@styled
def draw_archives(shown: Sequence[ArchivePanel], objective: str, width: float = PAGE) -> Figure:
    """Draw archives side by side, all on one colour scale.

    Args:
        shown: of one objective.
        objective: what the colours mean, with its unit.
        width: in inches.
    """
    across = min(len(shown), max(1, int(width / _NARROWEST)))
    down = -(-len(shown) // across)
    figure = new_figure(width, down * (_TALL * width / across + _TITLES) + _TITLES)
    panels = figure.subplots(down, across, squeeze=False).ravel()
    filled = np.concatenate([one.objectives[np.isfinite(one.objectives)] for one in shown])
    low, high = (filled.min(), filled.max()) if len(filled) else (0.0, 1.0)
    image = None
    for place, (axes, one) in enumerate(zip(panels, shown, strict=False)):
        image = draw_heatmap(axes, one.objectives, one.measures, low, high)
        share = np.isfinite(one.objectives).mean()
        letters = int(_LETTERS_PER_INCH * width / across)
        title = "\n".join([*wrap(one.title, letters), f"{share:.1%} filled"])
        axes.set_title(title, fontsize=SMALL + 0.5)
        axes.set_xlabel("\n".join(wrap(axes.get_xlabel(), letters)))
        if place % across and one.measures[1:] == shown[place - 1].measures[1:]:
            axes.set_ylabel("")
    for axes in panels[len(shown) :]:
        axes.set_axis_off()
    assert image is not None
    bar = figure.colorbar(
        image, ax=list(panels), location="bottom", shrink=0.6, aspect=40, label=objective
    )
    bar.outline.set_linewidth(0.4)
    return figure


_MARK = "#e8590c"
_MARKERS = {"start": "o", "goal": "*"}  # any other mark is a square


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
    meaning = run.schema
    pictures = [place / f"archive.{form}", place / f"progress.{form}"]
    size: Any = {} if width is None else {"width": width}
    save_heatmap(pictures[0], _objectives(run), meaning.measures, label=meaning.objective, **size)
    progress = draw_progress(group_runs([run]), meaning.objective, **size)
    save_figure(progress, pictures[1])
    notes = read_notes(run.path / NOTES)
    if notes:
        pictures.append(place / f"notes.{form}")
        save_figure(_draw_notes(notes), pictures[-1])
    if (best := run.read_best_layout()) is not None:
        layout, marks = best
        pictures.append(place / f"best_layout.{form}")
        axes = draw_layout(layout, meaning.tiles, names=meaning.names)
        draw_marks(axes, marks)
        figure = axes.get_figure()
        assert isinstance(figure, Figure)
        save_figure(figure, pictures[-1], crop=True)
    return pictures


def draw_marks(axes: Axes, marks: Mapping[str, tuple[int, int]]) -> None:
    """Mark named cells (row, column) on a drawn layout, with their names beside them."""
    rows, _ = np.array(axes.get_ylim())
    for name, (row, column) in marks.items():
        axes.scatter(
            column,
            row,
            s=42,
            color=_MARK,
            marker=_MARKERS.get(name, "s"),
            edgecolors="white",
            lw=0.6,
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
            color=_MARK,
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6, "alpha": 0.85},
        )


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
    groups, objective = group_runs(runs), runs[0].schema.objective
    pictures = [folder / f"archives.{form}", folder / f"progress.{form}"]
    shown = [
        ArchivePanel(group._replace(runs=(run,)).title, _objectives(run), run.measures)
        for group in groups
        for run in group.runs
    ]
    save_figure(draw_archives(shown, objective, width), pictures[0])
    save_figure(draw_progress(groups, objective, width), pictures[1])
    return pictures


def _objectives(run: RunDirectory) -> np.ndarray:
    """Read the objectives of all cells of a run's archive, float [C], NaN where empty."""
    archive = run.archive.columns
    return scatter_objectives(archive["index"], archive["objective"], run.measures)
