"""How often fleets congest, and what they move: Tables 2 and 5, Figure 17's rule, section E.4.

    python -m experiments.congestion human.json dsage.json --agents 150,200,250,300 \
        --timesteps 5000 --seeds 50 --planners published,plain,high,low --out runs/s.csv
    qdenv layout tile nca_a5.json --rows 101 --cols 102 --out nca_a5_tiled.json    # section E.4
    python -m experiments.congestion nca_a5_tiled.json --agents 1400 --out runs/tiled.csv
    python -m experiments.congestion --out runs/all.csv --read runs/s.csv runs/tiled.csv

Each run is a row of a file and is not simulated again, so this can be stopped and started again,
and several can work at once, each with a file of its own. The paper's figures appear where a file's
name says whose layout it is: nca_a0, nca_a1, nca_a5, dsage, human or tiled.
"""

from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from matplotlib.artist import Artist
from matplotlib.axes import Axes

import qdenv
from experiments.ledger import Case, Outcome, complete, outcomes_of, read_runs
from experiments.pieces import table
from experiments.program import run_program
from experiments.published import TRAFFIC
from experiments.traffic import describe, name_layouts
from qdenv.io.files import write_csv
from qdenv.study.options import parse_counts, parse_seeds
from qdenv.study.plans import read_plan
from qdenv.view.style import new_grid, save_figure, styled

# What files call a layout's maker: the first that fits counts, as a tiled layout's name may say
# whose layout was tiled. The paper's tables call nca_a0 and nca_a1 by their alphas alone.
MAKERS = ("tiled", "nca_a0", "nca_a1", "nca", "dsage", "human")
LOOKS = {  # Okabe and Ito 2008
    "published": ("#D55E00", "o"),
    "plain": ("#CC79A7", "s"),
    "high": ("#0072B2", "^"),
    "low": ("#E69F00", "v"),
}
HEAD = (
    *("layout", "agents", "T", "planner", "success (95 %)", "tasks / timestep"),
    *("paper, T = 5000", "CPU s / run", "congested at"),
)


def paper_on(row: Outcome) -> str:
    """Find what the paper says of a case by the layout's name; "" for nothing."""
    maker = next((word for word in MAKERS if word in row.layout), "").removeprefix("nca_")
    return str(TRAFFIC.get((row.domain, maker, row.agents), ""))


def who(row: Outcome) -> str:
    """Return the name of the planner, and whether congestion ended runs."""
    return row.planner if row.stop else f"{row.planner}, going on"


def cells_of(row: Outcome) -> tuple[object, ...]:
    """Return a row of the table."""
    jams = f"{row.jam_median:.0f} ({row.jam_least:.0f} to {row.jam_most:.0f})"
    return (
        *(f"{row.layout} ({row.domain})", row.agents, row.timesteps, who(row)),
        *(*describe([row]), paper_on(row), f"{row.cpu_seconds:.2f}"),
        "" if np.isnan(row.jam_median) else jams,
    )


def plot(axes: Axes, rows: Sequence[Outcome]) -> None:
    """Draw the mean over all runs of one layout over agents, with success rates below 100 %."""
    lines: dict[tuple, list[Outcome]] = {}
    for row in sorted(rows, key=lambda row: row.agents):
        lines.setdefault((who(row), row.timesteps), []).append(row)
    for (name, timesteps), own in lines.items():
        colour, marker = LOOKS[own[0].planner]
        agents, means = [row.agents for row in own], [row.mean_of_all for row in own]
        style, error = "-" if own[0].stop else "--", [row.error_of_all for row in own]
        axes.errorbar(agents, means, np.nan_to_num(error), color=colour, ls=style, capsize=3)
        label = f"{name}, T = {timesteps}"
        axes.plot(agents, means, marker, color=colour, ls=style, label=label)
        look: Any = {"textcoords": "offset points", "color": colour, "fontsize": 7}
        for row in (row for row in own if row.successes < row.runs):
            spot = (row.agents, row.mean_of_all)
            axes.plot(*spot, marker, color=colour, mfc="white")
            axes.annotate(f"{row.successes / row.runs:.0%}", spot, (5, -10), **look)
    axes.set_xticks(sorted({row.agents for row in rows}))


@styled
def draw(path: Path, rows: Sequence[Outcome]) -> None:
    """Draw throughput over agents, a panel per layout."""
    panels: dict[tuple[str, str], list[Outcome]] = {}
    for row in rows:
        panels.setdefault((row.layout, row.domain), []).append(row)
    figure, grid = new_grid(len(panels), 3, (3.6, 3), (1, 0.9))
    labels: dict[str, Artist] = {}
    for axes, (name, own) in zip(grid, panels.items(), strict=True):
        plot(axes, own)
        axes.set_title(f"{name[0]} ({name[1]})", fontsize="small")
        axes.set(
            xlabel="agents", ylabel="tasks / timestep, all runs", ylim=(0, 1.06 * axes.dataLim.y1)
        )
        labels |= dict(zip(*axes.get_legend_handles_labels()[::-1], strict=True))
    figure.legend(list(labels.values()), list(labels), loc="outside lower center", ncols=4)
    figure.suptitle("hollow: some runs congest; per cent: how many do not", fontsize="small")
    save_figure(figure, path)


def main(
    layouts: Annotated[tuple[Path, ...], tyro.conf.Positional] = (),
    agents: str = "200",
    timesteps: int = 5000,
    seeds: str = "50",
    planners: str = "published,plain,high,low",
    domain: str | None = None,
    stop: bool = True,
    out: Path = Path("runs/congestion.csv"),
    read: tuple[Path, ...] = (),
) -> None:
    """Simulate what is missing; print the table of all runs in the files, and draw it.

    Args:
        layouts: layout files; none to simulate nothing.
        agents: numbers of agents: 200, or 150,200, or 50:400:50.
        timesteps: horizon T.
        seeds: how many seeds, or a list of them.
        planners: published, plain, high, low: those of priority-based search, and ours.
        domain: whose tasks the agents do; what each file says, or its tiles tell, unless given.
        stop: end a run where it congests.
        out: file of runs that grows; the table (-table.csv) and the picture go beside it.
        read: further files of runs.
    """
    plans = {name: read_plan(path, domain) for name, path in name_layouts(layouts).items()}
    cases = [
        Case(name, plan.layout, plan.domain, count, timesteps, planner, stop)
        for (name, plan), count, planner in product(
            plans.items(), parse_counts(agents), planners.split(",")
        )
    ]
    complete(out, cases, parse_seeds(seeds), read)
    files = [*read, *([out] if out.exists() else [])]
    rows = outcomes_of(run for path in files for run in read_runs(path))
    if not rows:
        raise qdenv.InputError("no runs: give layout files, or tables of runs with --read")
    print("\n".join(table(HEAD, [cells_of(row) for row in rows])))
    csv, picture = out.with_name(f"{out.stem}-table.csv"), out.with_suffix(".png")
    write_csv(csv, (*Outcome._fields, "paper"), [(*row, paper_on(row)) for row in rows])
    draw(picture, rows)
    print(f"{out}, {csv}, {picture}")


if __name__ == "__main__":
    run_program(main, "python -m experiments.congestion")
