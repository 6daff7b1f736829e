"""Functions about runs, which are folders or what `train` returned."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from qdenv.api.results import Facts, Layout
from qdenv.presets import find_preset
from qdenv.run.archive import Elite
from qdenv.run.config import RunConfig, resolve
from qdenv.run.directory import RunDirectory
from qdenv.run.executors.base import Execution
from qdenv.types import RepairStatus


def train(
    preset: str | RunConfig = "quick",
    path: str | Path | None = None,
    progress: bool = True,
    execution: Execution = Execution(),  # noqa: B008 (frozen)
    **settings: Any,
) -> RunDirectory:
    """Search generators and leave everything in a new run directory.

    Args:
        preset: name of a preset, or a whole configuration.
        path: the folder to make; a fresh one under runs/ unless given.
        progress: show a progress bar.
        execution: where layouts are repaired and simulated; the same is found everywhere.
        **settings: in place of the preset's, by the names of `qdenv train --help` with
            underscores: evaluations=300, seed=3, alpha=1.0, agents=40, shelves=60. Domains,
            planners, generators and algorithms may be named, or given as settings:
            planner="pbs", planner=PbsConfig(rule="plain"). What is not stated follows the size:
            numbers of tiles, agents, steps and axes.

    Raises:
        InputError: a name is unknown, a setting is impossible, or the folder holds a run already.
    """
    from qdenv.run import loop

    base = find_preset(preset) if isinstance(preset, str) else preset
    config, scaled = resolve(base, settings)
    if progress and scaled:
        print(scaled)
    stamp = datetime.now().strftime("%Y%m%d-%H%M%S")
    name = preset if isinstance(preset, str) else "run"
    return loop.train(config, path or Path("runs") / f"{name}-{stamp}", progress, execution)


def generate(
    run: RunDirectory | str | Path,
    rows: int | None = None,
    cols: int | None = None,
    elite: str | Sequence[int] | Elite = "best",
    steps: int | None = None,
    seed: int | None = None,
    repair: bool = True,
    **numbers: int,
) -> Layout:
    """Grow an elite of a run at any size and repair it.

    Args:
        run: the run, or its folder.
        rows: of the layout; the trained size unless given.
        cols: of the layout; the trained size unless given.
        elite: "best", a cell like "12,40" or (12, 40), or what `run.elite` found.
        steps: of growth; unless given what is known of the size, or else scaled with it.
        seed: of the repair; the run's own unless given.
        repair: False keeps what the generator drew.
        **numbers: exact numbers of tiles; likewise.

    Raises:
        InputError: there is no such elite, or no layout of this size obeys the rules.
    """
    from qdenv.study.elites import find_elite, grow_elite, repair_grown

    opened = run if isinstance(run, RunDirectory) else RunDirectory.open(run)
    config = opened.config
    found = elite if isinstance(elite, Elite) else find_elite(opened, elite)
    grown = grow_elite(opened, found, (rows, cols), steps, numbers)
    facts: dict[str, Any] = {"elite": ",".join(map(str, found.cell)), "steps": grown.steps}
    chosen = config.seed if seed is None else seed
    repaired = repair_grown(grown, config.evaluation.repair, chosen) if repair else None
    if repaired is None:
        return Layout(grown.layout, grown.domain, facts)
    status = RepairStatus(int(repaired.status)).name.lower()
    facts |= {"repair": status, "changed": float(repaired.cost)}
    return Layout(np.asarray(repaired.layout), grown.domain, facts)


def surrogate(
    run: RunDirectory | str | Path,
    seeds: int | str | Sequence[int] = 3,
    size: str = "small",
    **settings: Any,
) -> Facts:
    """Predict a run's elites by a surrogate that learns from the others: R2, RMSE, rank.

    Args:
        run: the run, or its folder; its archive needs 50 elites or more.
        seeds: 3 for three random splits, "3,5,9" or (3, 5, 9) for these.
        size: "small" or "published".
        **settings: single numbers of the surrogate, like epochs=100, by the names of
            `qdenv surrogate --help`.

    Raises:
        InputError: there are too few elites, or a setting means nothing.
    """
    from qdenv.study.options import find_surrogate, parse_seeds
    from qdenv.study.surrogate import read_elites

    config, chosen = find_surrogate(size, settings), parse_seeds(seeds)
    elites = read_elites(run if isinstance(run, RunDirectory) else RunDirectory.open(run))
    from qdenv.study.surrogate import facts_of, try_surrogate

    return Facts(facts_of(elites, config, try_surrogate(elites, config, chosen)))
