"""Figure 19: tiled layouts of 101 x 102 and where agents are, beside grown ones (E.4)."""

from itertools import product

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap

from experiments.archives import note
from experiments.courses import SavedCourse
from experiments.layouts import S_EVAL, SavedLayout
from experiments.lines import LOOKS
from experiments.panels import show_layout
from experiments.pieces import Drawn, Experiment, Folders, Piece, table
from experiments.published import AGENTS, FLEETS, TRAFFIC
from experiments.table_5 import TABLE
from experiments.traffic import SavedTraffic, describe
from qdenv.view.style import new_figure

MAPPED = 5  # runs whose usage is drawn
MOST = 4.0  # times an even spread, where the colours end
# Not down to the darkest red: obstacles are black.
COLOURS = ListedColormap(colormaps["YlOrRd"](np.linspace(0, 0.85, 256)))
MAKERS = ("tiled", "nca")
RUNS = {
    (domain, maker): TABLE[domain, "nca", S_EVAL, "high"]
    if maker == "nca"
    else SavedTraffic(SavedLayout(domain, maker, S_EVAL), "tiled", (AGENTS[domain][S_EVAL],))
    for domain, maker in product(FLEETS, MAKERS)
}
USAGE = {
    (domain, maker): SavedCourse(saved.layout, AGENTS[domain][S_EVAL], seeds=MAPPED, stop=True)
    for (domain, maker), saved in RUNS.items()
}
HEAD = (
    *("domain", "layout", "agents", "cells changed", "success (95 %)", "tasks / timestep"),
    "paper (success)",
)


def draw(folders: Folders) -> Drawn:
    """Draw each tiled layout, its usage and that of the grown one; write what they move."""
    figure = new_figure(4.2 * len(FLEETS), 13, dpi=100)
    panels = figure.subplots(3, len(FLEETS))
    for column, domain in enumerate(FLEETS):
        title = f"{domain}: {LOOKS['tiled'].label}"
        show_layout(panels[0, column], RUNS[domain, "tiled"].layout, folders, title)
        for axes, maker in zip(panels[1:, column], MAKERS, strict=True):
            show_usage(axes, USAGE[domain, maker], folders)
    drawn = [axes.images[-1] for axes in panels[1:].flat if axes.images]
    if drawn:
        label = "time on the cell, times an even spread over the free cells"
        figure.colorbar(drawn[0], ax=panels[1:], shrink=0.5, extend="max", label=label)
    rows: list[tuple[object, ...]] = []
    for (domain, maker), saved in RUNS.items():
        (agents,), layout, refusal = saved.agents, saved.layout, saved.layout.refusal(folders)
        known = layout.done(folders) and not refusal
        changed = layout.read(folders).facts["changed"] if known else ""
        moved = describe(saved.outcomes(folders), refusal)
        paper = TRAFFIC[domain, maker, agents]
        rows.append((domain, LOOKS[maker].label, agents, changed, *moved, paper))
    said = f"Our planner; T = 5000; usage: share of all agents' time, mean of {MAPPED} runs"
    return Drawn(figure, (*table(HEAD, rows), "", f"{said}, until they congest."))


def show_usage(axes: Axes, saved: SavedCourse, folders: Folders) -> None:
    """Draw where agents are over the obstacles, or say that it is not made yet."""
    found = saved.read(folders)
    if found is None:
        note(axes, f"usage of {saved.layout.stem}\nnot made yet")
        return
    made = saved.layout.read(folders)
    axes.imshow(made.free, cmap=ListedColormap(["#000000", "#ffffff"]), vmin=0, vmax=1)
    usage = np.ma.masked_where(found.usage == 0, found.usage / found.runs * made.free.sum())
    axes.imshow(usage, cmap=COLOURS, vmin=0, vmax=MOST, interpolation="nearest")
    axes.tick_params(length=0, labelbottom=False, labelleft=False)
    maker = LOOKS[saved.layout.maker].label
    jams = f"{found.congested} of {found.runs} runs congest"
    axes.set_title(f"{maker}, {saved.agents} agents: {jams}", fontsize="small")


PIECES: tuple[Piece, ...] = (*RUNS.values(), *USAGE.values())
EXPERIMENT = Experiment("tiled layouts, where agents are (section E.4)", PIECES, draw)
