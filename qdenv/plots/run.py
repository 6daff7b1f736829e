"""The pictures of a run: its archive, its best layout, its progress."""

import json
from pathlib import Path

from matplotlib.figure import Figure

from qdenv.files import write_atomically
from qdenv.grid import parse
from qdenv.plots.archive import save_heatmap, scatter_objectives
from qdenv.plots.layouts import save_layout
from qdenv.train.records import RunDirectory


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
        save_layout(pictures[-1], layout, run.tiles)
    return pictures


def save_progress(path: Path, run: RunDirectory) -> None:
    """Draw QD-score, coverage and best objective over evaluations (Figure 20)."""
    rows = run.read_metrics()
    figure = Figure(figsize=(9, 2.6), layout="constrained")
    panels = {"QD-score": "qd_score", "coverage": "coverage", "best objective": "best_objective"}
    for axes, (title, column) in zip(figure.subplots(1, 3), panels.items(), strict=True):
        axes.plot([row.evaluations for row in rows], [getattr(row, column) for row in rows])
        axes.set(title=title, xlabel="evaluations", ymargin=0.1)
        axes.set_ylim(bottom=0)
        axes.spines[["top", "right"]].set_visible(False)
    write_atomically(path, lambda file: figure.savefig(file, format="png", dpi=120))
