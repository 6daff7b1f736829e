"""Pictures of traffic: throughput and success over numbers of agents (Figure 22)."""

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from qdenv.files import write_atomically


def save_sweep(path: Path, rows: Sequence[Any], title: str = "") -> None:
    """Draw a sweep: throughput of successful runs above, success rates with their bounds below.

    Args:
        path: picture to write.
        rows: records with `agents`, `throughput`, `standard_error`, `success_rate`,
            `success_low`, `success_high` (`qdenv.study.sweep.SweepRow`).
        title: heading.
    """
    agents = [row.agents for row in rows]
    figure = Figure(figsize=(6, 5), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    error = np.nan_to_num([row.standard_error for row in rows])
    above.errorbar(agents, [row.throughput for row in rows], error, marker="o", capsize=3)
    above.set(ylabel="throughput [tasks / timestep]", title=title)
    rate = np.array([row.success_rate for row in rows])
    low = rate - [row.success_low for row in rows]
    high = np.array([row.success_high for row in rows]) - rate
    below.errorbar(agents, rate, np.maximum([low, high], 0), marker="o", capsize=3)
    below.set(xlabel="agents", ylabel="success rate", ylim=(-0.05, 1.05))
    for axes in (above, below):
        axes.grid(alpha=0.3)
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=150)
    write_atomically(path, picture.getvalue())
