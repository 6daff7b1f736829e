"""The pictures of a run: its archive, its best layout, its progress."""

import json
from pathlib import Path

from qdenv.domains.base import make_domain
from qdenv.grid import parse
from qdenv.plots.archive import save_heatmap, scatter_objectives
from qdenv.plots.figure import new_figure, save_figure
from qdenv.plots.layouts import save_layout
from qdenv.training.records import RunDirectory


def plot_run(run: RunDirectory) -> list[Path]:
    """Draw archive.png, progress.png and best_layout.png into a run's folder.

    Returns:
        the pictures that could be drawn: none of an empty archive's layout.

    Raises:
        InputError: the run has saved no archive yet.
    """
    archive, measures = run.load_archive(), run.measures
    pictures = [run.path / "archive.png", run.path / "progress.png"]
    objectives = scatter_objectives(archive["index"], archive["objective"], measures)
    save_heatmap(pictures[0], objectives, measures)
    save_progress(pictures[1], run)
    best = run.path / "best_layout.json"
    if best.exists():
        layout = parse(json.loads(best.read_text())["layout"], run.tiles)
        pictures.append(run.path / "best_layout.png")
        names = make_domain(run.config.evaluation.domain).names
        save_layout(pictures[-1], layout, run.tiles, names)
    return pictures


def save_progress(path: Path, run: RunDirectory) -> None:
    """Draw QD-score, coverage and best objective over evaluations (Figure 20)."""
    rows = run.read_metrics()
    figure = new_figure(9, 2.6, dpi=120)
    panels = {"QD-score": "qd_score", "coverage": "coverage", "best objective": "best_objective"}
    for axes, (title, column) in zip(figure.subplots(1, 3), panels.items(), strict=True):
        axes.plot([row.evaluations for row in rows], [getattr(row, column) for row in rows])
        axes.set(title=title, xlabel="evaluations", ymargin=0.1)
        axes.set_ylim(bottom=0)
        axes.spines[["top", "right"]].set_visible(False)
    save_figure(figure, path)
