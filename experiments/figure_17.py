"""Figure 17: tasks finished over time at 33 x 36, runs not stopped where they congest."""

from itertools import product

import numpy as np

from experiments.courses import BIN, SavedCourse
from experiments.layouts import S, SavedLayout
from experiments.lines import LOOKS, draw_line, finish, new_panels
from experiments.pieces import Drawn, Experiment, Folders, table
from experiments.published import AGENTS, FLEETS, TRAFFIC

MAKERS = ("nca", "human")
COURSES = {
    (domain, maker): SavedCourse(SavedLayout(domain, maker), agents=AGENTS[domain][S])
    for domain, maker in product(FLEETS, MAKERS)
}
HEAD = (
    *("domain", "layout", "runs", "congested", "tasks / timestep, first fifth", "last fifth"),
    "paper, where congestion ends runs",
)


def draw(folders: Folders) -> Drawn:
    """Draw the mean of all runs with its 95 % interval, a panel per domain."""
    figure, panels = new_panels(1, len(FLEETS), FLEETS)
    rows: list[tuple[object, ...]] = []
    for (domain, maker), saved in COURSES.items():
        axes, found = panels[0, FLEETS.index(domain)], saved.read(folders)
        paper = TRAFFIC[domain, maker, saved.agents]
        if found is None:
            rows.append((domain, LOOKS[maker].label, "not made yet", "", "", "", paper))
            continue
        mean, half = found.rates
        draw_line(axes, BIN * np.arange(1, len(mean) + 1), mean, half, maker)
        fifth = max(1, len(mean) // 5)
        moved = [f"{part.mean():.2f}" for part in (mean[:fifth], mean[-fifth:])]
        runs = f"{found.runs} of {saved.seeds}"
        rows.append((domain, LOOKS[maker].label, runs, found.congested, *moved, paper))
    for axes in panels[0]:
        axes.set_xlabel("timestep")
    panels[0, 0].set_ylabel("tasks finished / timestep")
    finish(figure, panels)
    note = "Under our planner. The paper: what automata draw moves a stable number of tasks all the"
    return Drawn(figure, (*table(HEAD, rows), "", f"{note} time."))


EXPERIMENT = Experiment("tasks finished over time, 200 agents", tuple(COURSES.values()), draw)
