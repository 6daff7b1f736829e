"""Pictures of runs: archives, progress over evaluations, the best layout, a surrogate's errors."""

from collections.abc import Sequence
from pathlib import Path
from textwrap import wrap
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter, PercentFormatter, StrMethodFormatter

from qdenv.domains.base import make_domain
from qdenv.run.directory import Note, RunDirectory
from qdenv.study.groups import CURVES, Group, band_of, group_runs
from qdenv.types import Measure
from qdenv.view import PAGE, style
from qdenv.view.archive import TALL, WIDTH, draw_archive, draw_heatmap, scatter_objectives
from qdenv.view.layouts import draw_marks, draw_plan

_DASHES = ("-", "--", ":", "-.")  # of lines beyond the colours
_TALL = 0.85  # of its width: the height of a panel
_TITLES = 0.55  # inches above and below it


@style.styled
def _draw_notes(notes: list[Note]) -> Figure:
    """Draw a panel for each kind of number: ``loss_repair`` and ``loss_usage`` are of one kind."""
    kinds: dict[str, list[str]] = {}
    for name in notes[0]:
        if name not in ("iteration", "evaluations", "fits"):  # counters
            kinds.setdefault(name.partition("_")[0], []).append(name)
    figure, panels = style.new_grid(len(kinds), 4, (2.5, 3.4), dpi=style.SCREEN_DPI)
    evaluations = [note["evaluations"] for note in notes]
    for axes, (kind, names) in zip(panels, kinds.items(), strict=True):
        for name in names:
            label = name.removeprefix(f"{kind}_").replace("_", " ")
            axes.plot(evaluations, [note[name] for note in notes], ".-", label=label, lw=1)
        axes.set(title=kind if len(names) > 1 else names[0].replace("_", " "))
        axes.set_xlabel("true evaluations")
        if kind in ("loss", "rmse"):  # they shrink by factors
            axes.set_yscale("log")
            # The usual ones write mathematics.
            axes.yaxis.set(major_formatter=LogFormatter(), minor_formatter=LogFormatter())
        if kind == "r2":
            axes.set_ylim(-1, 1)  # below -1 it is just bad
        if len(names) > 1:
            # Below the panel: inside, it would cover the curves.
            place: Any = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.2), "ncols": 2}
            axes.legend(fontsize="x-small", **place)
    return figure


@style.styled
def draw_progress(groups: Sequence[Group], objective: str, width: float = PAGE) -> Figure:
    """Draw QD-score, coverage and best objective over evaluations (Figure 20).

    A line for each group, the mean of its runs, with a band where there are several. `objective` is
    the label of what is maximised; on narrow paper the panels stand one below the other.
    """
    across, tall = (3, _TALL) if width >= style.ABREAST else (1, 0.5)
    down = 3 // across
    figure = style.new_figure(width, down * (tall * width / across + _TITLES))
    panels = figure.subplots(down, across, sharex=True).ravel()
    for axes, (name, title) in zip(panels, CURVES.items(), strict=True):
        for place, group in enumerate(groups):
            mean, half = band_of(group.curves[name])
            colour = style.colour(place)
            # A line through one point is invisible: the last point is marked.
            look: Any = {"color": colour, "marker": "o", "markevery": [len(mean) - 1]}
            dashes = _DASHES[place // len(style.PALETTE) % len(_DASHES)]
            axes.plot(group.evaluations, mean, dashes, label=group.title, **look)
            if len(group.runs) > 1:
                low, high = mean - half, mean + half
                axes.fill_between(group.evaluations, low, high, color=colour, alpha=0.2, lw=0)
        axes.set(title=title, ymargin=0.1)
        if name != "best_objective":  # it hardly moves, seen from zero
            axes.set_ylim(bottom=min(0.0, *(group.curves[name].min() for group in groups)))
        axes.grid()
        if name == "coverage":
            axes.yaxis.set_major_formatter(PercentFormatter(1.0))
        # Few and full numbers: "1e6" would need a reader who looks for it at the axis' end.
        axes.locator_params(axis="x", nbins=4)
        axes.xaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
    panels[-1].set_ylabel(objective, fontsize=style.SMALL)
    for axes in panels if down == 1 else panels[-1:]:
        axes.set_xlabel("evaluations")
    if len(groups) > 1:
        style.add_legend(figure, panels[0])
    if any(len(group.runs) > 1 for group in groups):
        meaning = "lines: mean over runs, bands: its 95 % interval"
        figure.supxlabel(meaning, fontsize=style.SMALL, color=style.GREY)
    return figure


@style.styled
def draw_archives(
    archives: Sequence[tuple[str, np.ndarray, Sequence[Measure]]],
    objective: str,
    width: float = PAGE,
) -> Figure:
    """Draw archives side by side, all on one colour scale.

    An archive is its title, the objectives of its cells (float [C], row-major, not finite where
    empty) and its axes; `objective` is the label of the colours.
    """
    across = min(len(archives), max(1, int(width / 1.65)))  # inches of the narrowest panel
    size = width / across, _TALL * width / across + _TITLES
    figure, panels = style.new_grid(len(archives), across, size, (0, _TITLES))
    filled = np.concatenate([values[np.isfinite(values)] for _, values, _ in archives])
    # One scale for all, from the worst elite to the best.
    low, high = (filled.min(), filled.max()) if len(filled) else (0.0, 1.0)
    letters = int(12 * width / across)  # of a line above a panel: 12 fit an inch
    image = None
    for place, (axes, one) in enumerate(zip(panels, archives, strict=True)):
        title, values, measures = one
        image = draw_heatmap(axes, values, measures, low, high)
        share = f"{np.isfinite(values).mean():.1%} filled"
        axes.set_title("\n".join([*wrap(title, letters), share]), fontsize=style.SMALL + 0.5)
        axes.set_xlabel("\n".join(wrap(axes.get_xlabel(), letters)))
        if place % across and measures[1:] == archives[place - 1][2][1:]:
            axes.set_ylabel("")  # its left neighbour names the same axis
    assert image is not None
    look: Any = {"location": "bottom", "shrink": 0.6, "aspect": 40}
    figure.colorbar(image, ax=panels, label=objective, **look).outline.set_linewidth(0.4)
    return figure


def plot_run(
    run: RunDirectory, folder: Path | None = None, form: str = "png", width: float | None = None
) -> list[Path]:
    """Draw archive.png, progress.png and best_layout.png of a run, notes.png if it has notes.

    They go to `folder`, the run's own unless given, in the form png, svg or pdf; archive and
    progress are `width` inches wide, or suit a screen. Return the pictures, without one of the best
    layout if the archive is empty. Raises InputError if the run has saved no archive yet or one of
    more than two measures, a file is damaged or cannot be written, or it is the zoo's own folder.
    """
    if folder is None:
        run.demand_own()
    schema, place = run.schema, folder or run.path
    pictures = [place / f"archive.{form}", place / f"progress.{form}"]
    heatmap = style.new_figure(width or WIDTH, TALL * (width or WIDTH))
    objectives = scatter_objectives(run.archive.columns, run.measures)
    draw_archive(heatmap, objectives, schema.measures, label=schema.objective)
    style.save_figure(heatmap, pictures[0])
    progress = draw_progress(group_runs([run]), schema.objective, width or PAGE)
    style.save_figure(progress, pictures[1])
    if notes := run.read_notes():
        pictures.append(place / f"notes.{form}")
        style.save_figure(_draw_notes(notes), pictures[-1])
    if len(archive := run.archive):
        layout, domain = archive.best.layout, make_domain(run.config.evaluation.domain)
        pictures.append(place / f"best_layout.{form}")
        figure = draw_plan(layout, schema.tiles, schema.tile_names, numbered=False)
        draw_marks(figure.axes[0], domain.mark_cells(layout))
        style.save_figure(figure, pictures[-1], crop=True)
    return pictures


def plot_runs(
    runs: Sequence[RunDirectory], folder: Path, form: str = "png", width: float = PAGE
) -> list[Path]:
    """Draw the archives of several runs on one colour scale, and their progress by groups.

    The arguments are those of `plot_run`; all runs have one objective. Raises InputError as
    `groups.group_runs` does, or if an archive has more than two measures.
    """
    groups, objective = group_runs(runs), runs[0].schema.objective
    pictures = [folder / f"archives.{form}", folder / f"progress.{form}"]
    archives = []
    for group in groups:
        for run in group.runs:
            objectives = scatter_objectives(run.archive.columns, run.measures)
            archives.append((group._replace(runs=(run,)).title, objectives, run.measures))
    style.save_figure(draw_archives(archives, objective, width), pictures[0])
    style.save_figure(draw_progress(groups, objective, width), pictures[1])
    return pictures
