"""Figure 17: tasks finished over time at 33 x 36, runs not stopped where they congest."""

from itertools import product

import numpy as np

from experiments.courses import BIN, SavedCourse
from experiments.layouts import S, SavedLayout
from experiments.lines import LOOKS, draw_line, finish, new_panels
from experiments.pieces import Drawn, Experiment, Folders, table
from experiments.published import AGENTS, FLEETS, TRAFFIC
from experiments.table_5 import PLANNERS

MAKERS = ("nca", "human")
COURSES = {
    (planner, domain, maker): SavedCourse(
        SavedLayout(domain, maker), agents=AGENTS[domain][S], planner=planner
    )
    for planner, domain, maker in product(PLANNERS, FLEETS, MAKERS)
}
HEAD = (
    *("domain", "layout", "planner", "runs", "congested", "tasks / timestep, first fifth"),
    *("last fifth", "paper, where congestion ends runs"),
)


def draw(folders: Folders) -> Drawn:
    """Draw the mean of all runs with its 95 % interval, a panel per planner and domain."""
    figure, panels = new_panels(len(PLANNERS), len(FLEETS), FLEETS)
    rows: list[tuple[object, ...]] = []
    for (planner, domain, maker), saved in COURSES.items():
        axes = panels[list(PLANNERS).index(planner), FLEETS.index(domain)]
        found, paper = saved.read(folders), TRAFFIC[domain, maker, saved.agents]
        named = (domain, LOOKS[maker].label, PLANNERS[planner])
        if found is None:
            rows.append((*named, "not made yet", "", "", "", paper))
            continue
        mean, half = found.rates
        draw_line(axes, BIN * np.arange(1, len(mean) + 1), mean, half, maker)
        fifth = max(1, len(mean) // 5)
        moved = [f"{part.mean():.2f}" for part in (mean[:fifth], mean[-fifth:])]
        rows.append((*named, f"{found.runs} of {saved.seeds}", found.congested, *moved, paper))
    for line, planner in zip(panels, PLANNERS.values(), strict=True):
        line[0].set_ylabel(f"tasks finished / timestep\n{planner}")
        for axes in line:
            axes.set_xlabel("timestep")
    finish(figure, panels)
    note = "The paper: what automata draw moves a stable number of tasks all the time."
    return Drawn(figure, (*table(HEAD, rows), "", note))


EXPERIMENT = Experiment("tasks finished over time, 200 agents", tuple(COURSES.values()), draw)
