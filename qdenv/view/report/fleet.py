"""The study behind a report on layouts in which a fleet drives."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from qdenv.grid import of_tiles
from qdenv.progress import Progress, silent
from qdenv.simulate.mapf.settings import FleetConfig
from qdenv.study.options import fleet_tasks, usual_fleet
from qdenv.study.table import Row, Trial, about, compare, find_peak
from qdenv.study.traffic import Study, examine
from qdenv.view.report.subjects import Rival, Subject, find_rival

_SHARES = (0.5, 0.75, 1.0, 1.25, 1.5)  # of the number of agents that is asked about


class Asked(NamedTuple):
    """What a report shall find out."""

    subjects: list[Subject]  # the layouts, of one domain
    rivals: list[Rival]  # what people draw by hand at the size of each subject
    agents: int | None  # the number that is looked at closely; None for the first layout's peak
    counts: tuple[int, ...]  # the numbers of agents that are simulated, few to many
    config: FleetConfig  # the numbers of a simulation
    seeds: tuple[int, ...]  # of the runs with each number of agents
    said: str  # what a known size brings along; "" for nothing
    per_hour: float | None = None  # timesteps per hour; None where nobody said


class Found(NamedTuple):
    """What was found out."""

    asked: Asked  # what for
    agents: int  # the number that was looked at closely
    rows: list[Row]  # of all layouts and numbers of agents, the hand-made ones after the others
    studies: list[Study]  # of each subject with this number

    def rows_of(self, name: str) -> list[Row]:
        """List the rows of one layout."""
        return [row for row in self.rows if row.layout == name]

    def row_at(self, name: str) -> Row:
        """Find the row of a layout at the number of agents that was looked at closely."""
        return next(row for row in self.rows_of(name) if row.agents == self.agents)


def ask(
    subjects: list[Subject],
    agents: Sequence[int],
    timesteps: int | None,
    config: Callable[[int, int], FleetConfig],
    seeds: tuple[int, ...],
) -> Asked:
    """Check what a report shall find out, before anything is simulated.

    Args:
        subjects: the layouts, of one domain.
        agents: one number, around which others are chosen; or several, in place of those; or none
            for the usual number.
        timesteps: horizon T; the usual one unless given.
        config: makes the numbers of a simulation of agents and timesteps.
        seeds: of the runs.

    Raises:
        InputError: a fleet cannot work on one of the layouts, or the numbers make no simulation.
    """
    domain, layouts = subjects[0].plan.domain, [one.layout for one in subjects]
    usual, timesteps, note = usual_fleet(domain, layouts, max(agents, default=None), timesteps)
    wanted = tuple(sorted(agents)) or (usual,)
    tasks = domain.simulator.tasks
    for one in subjects:
        with about(one.source):
            fleet_tasks(one.layout, tasks, wanted[-1])
    rivals = [find_rival(one, subjects) for one in subjects]
    assert tasks is not None
    every = [*layouts, *(one.layout for one in rivals if one.layout is not None)]
    most = min(int(of_tiles(one, tasks.traversable, tasks.tiles).sum()) for one in every)
    counts = wanted if len(wanted) > 1 else around(wanted[0], max(most, wanted[0]))
    return Asked(
        subjects=subjects,
        rivals=rivals,
        agents=wanted[0] if len(wanted) == 1 else None,
        counts=counts,
        config=config(max(counts), timesteps),
        seeds=seeds,
        said=note,
    )


def around(agents: int, most: int) -> tuple[int, ...]:
    """Choose numbers of agents around one, none larger than what fits."""
    return tuple(sorted({min(max(1, round(share * agents)), most) for share in _SHARES}))


def study(
    asked: Asked,
    told: Callable[[Row], None] = lambda row: None,
    progress: Progress = silent,
) -> Found:
    """Simulate all layouts and their rivals over numbers of agents, and look closely at one.

    Args:
        asked: what shall be found out.
        told: hears of every finished row.
        progress: hears how far it is.
    """
    tasks = asked.subjects[0].plan.domain.simulator.tasks
    layouts = _layouts_of(asked)
    trial = Trial(tasks, asked.config, asked.counts, asked.seeds)
    rows = compare(layouts, trial, told, progress)
    agents = asked.agents
    if agents is None:
        agents = find_peak([row for row in rows if row.layout == asked.subjects[0].name]).agents
    config = replace(asked.config, agents=agents)
    studies = []
    for one in asked.subjects:

        def tell(doing: str, share: float, note: str, name: str = one.name) -> None:
            progress(f"looking closely at {name}", share, note or doing)

        studies.append(examine(one.plan, config, asked.seeds, progress=tell))
    return Found(asked, agents, rows, studies)


def _layouts_of(asked: Asked) -> dict[str, np.ndarray]:
    """List all that is simulated by name: the subjects, then the hand-made layouts."""
    rivals = {one.name: one.layout for one in asked.rivals if one.layout is not None}
    return {one.name: one.layout for one in asked.subjects} | rivals


def seconds_for(asked: Asked, row: Row, threads: int) -> float:
    """Reckon from its first row how long a study takes: a run costs as much as it has agents.

    Args:
        asked: what shall be found out.
        row: the first one.
        threads: runs at a time.
    """
    per_agent = row.cpu_seconds_per_run * row.runs / row.agents / threads
    closely = (asked.agents or max(asked.counts)) * len(asked.subjects)
    return per_agent * (len(_layouts_of(asked)) * sum(asked.counts) + closely)
