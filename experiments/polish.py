"""What longer annealing and HiGHS gain (`--polish full`), on layouts that searches have found.

    python -m experiments.polish runs/warehouse-even runs/warehouse-uneven runs/manufacturing

Each drawing is repaired as a search does and in full, and both layouts are
simulated as in the search.
"""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import tyro

from experiments.pieces import table
from experiments.program import run_program
from qdenv.domains.base import make_domain
from qdenv.io.files import write_csv
from qdenv.ranges import PositiveInt
from qdenv.repairs.recipe import repair_layout
from qdenv.repairs.settings import Polish
from qdenv.run.directory import RunDirectory
from qdenv.stats import paired_difference
from qdenv.study.engine import run_seeds
from qdenv.types import InputError, RepairStatus

LEVELS: tuple[Polish, ...] = ("quick", "full")
HEAD = (
    *("domain", "polish", "layouts", "cells changed", "lower bound", "optimal", "CPU s"),
    *("tasks / timestep", "against quick (95 %)"),
)


class Row(NamedTuple):
    """A repair of one drawing."""

    domain: str  # its name
    cell: int  # of the archive whose elite drew it, row-major
    polish: str  # a level of `LEVELS`
    repair: str  # a RepairStatus by name
    changed: float  # cells
    bound: float  # the number of cells that any repair changes at least
    seconds: float  # CPU seconds of the repair
    throughput: float  # tasks per timestep, mean of all simulations, as in the search
    congested: int  # of the simulations


def repair_and_simulate(run: RunDirectory, count: int) -> list[Row]:
    """Repair what elites from all over an archive drew at both levels, and simulate the layouts.

    Elites that congested in the search are left out.
    """
    config, columns, rows = run.config.evaluation, run.archive.columns, []
    domain, seeds = make_domain(config.domain), range(config.simulations)
    if domain.rules is None:
        raise InputError(f"{run}: nothing is repaired in {domain.name}")
    rules, tasks, fleet = domain.rules(), domain.simulator.tasks, domain.config.fleet
    flowed = np.flatnonzero(~columns["congested"].any(axis=1))  # nobody builds the others
    if not len(flowed):
        raise InputError(f"{run}: every elite congested in the search")
    chosen = np.unique(np.linspace(0, len(flowed) - 1, count).round().astype(int))
    for place in flowed[chosen]:
        for level in LEVELS:
            how = replace(config.repair, polish=level)
            made = repair_layout(columns["unrepaired"][place], rules, run.config.seed, how)
            fleets = run_seeds(np.asarray(made.layout), tasks, fleet, seeds).runs
            status = RepairStatus(int(made.status)).name.lower()
            found = domain.name, int(columns["index"][place]), level, status
            costs = float(made.cost), float(made.lower_bound), round(float(made.seconds), 3)
            moved = float(np.mean([one.throughput for one in fleets]))
            rows.append(Row(*found, *costs, moved, sum(bool(one.congested) for one in fleets)))
        print(*rows[-2:], sep="\n", flush=True)
    return rows


def main(
    runs: Annotated[tuple[Path, ...], tyro.conf.Positional],
    layouts: PositiveInt = 67,
    out: Path = Path("runs/polish.csv"),
) -> None:
    """Repair elites of finished runs as a search does and in full, and simulate both layouts.

    Args:
        runs: folders of runs of domains with fleets.
        layouts: number of elites of each that flow, evenly spread over its archive.
        out: table to write.
    """
    rows = [row for path in runs for row in repair_and_simulate(RunDirectory.open(path), layouts)]
    write_csv(out, Row._fields, rows)
    lines = []
    for domain in dict.fromkeys(row.domain for row in rows):
        moved = {}
        for level in LEVELS:
            own = [row for row in rows if (row.domain, row.polish) == (domain, level)]
            moved[level] = [row.throughput for row in own]
            means = [np.mean([row[place] for row in own]) for place in (4, 5, 6, 7)]
            optimal = sum(row.repair == "optimal" for row in own)
            gained = str(paired_difference(moved[level], moved["quick"])) if level == "full" else ""
            numbers = f"{means[0]:.1f}", f"{means[1]:.1f}", optimal, f"{means[2]:.2f}"
            lines.append((domain, level, len(own), *numbers, f"{means[3]:.3f}", gained))
    print("\n".join(table(HEAD, lines)))


if __name__ == "__main__":
    run_program(main, "python -m experiments.polish")
