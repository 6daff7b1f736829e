"""Figure 20: QD-score and coverage over evaluations, with the paper's final values."""

import numpy as np
from matplotlib.ticker import EngFormatter

from experiments.archives import ALGORITHMS, RUNS, read_all
from experiments.lines import draw_band
from experiments.pieces import Drawn, Experiment, Folders
from experiments.published import TABLE_4
from qdenv.view.style import new_figure

METRICS = {"qd_score": "QD-score", "coverage": "coverage"}


def draw(folders: Folders) -> Drawn:
    """Draw a column of panels per domain that has runs."""
    found = read_all(folders)
    figure = new_figure(1 + 3.3 * len(found), 5.6, dpi=110)
    panels = figure.subplots(len(METRICS), len(found), squeeze=False)
    for metric, line in zip(METRICS, panels, strict=True):
        for (domain, runs), axes in zip(found.items(), line, strict=True):
            for name, own in runs.items():
                length = min(len(one.metrics) for one in own)  # as far as all of them came
                tables = [one.metrics[:length] for one in own]
                values = [[getattr(row, metric) for row in rows] for rows in tables]
                at = [row.evaluations for row in tables[0]]
                draw_band(axes, at, np.array(values), ALGORITHMS[name], f"{name} ({len(own)})")
            end = axes.dataLim.x1
            for name, (colour, _) in ALGORITHMS.items():
                if paper := TABLE_4.get((domain, name)):
                    axes.plot(end, getattr(paper, metric), "*", color=colour, markersize=10)
            axes.set(xlabel="evaluations", ylabel=METRICS[metric], ylim=(0, None))
            axes.xaxis.set_major_formatter(EngFormatter(sep=""))  # 100k needs less room
            axes.set_title(domain, fontsize="small")
            axes.legend(fontsize=7)
    note = "(number of runs); bands: 95 % intervals of means; stars: the paper's means at the end"
    figure.supxlabel(note, fontsize=8)
    return Drawn(figure)


EXPERIMENT = Experiment("QD-score and coverage over evaluations", RUNS, draw)
