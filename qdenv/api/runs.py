"""Functions about runs, which are folders or what `train` returned."""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from qdenv.api.results import Facts, Layout
from qdenv.presets import find_preset
from qdenv.run.archive import Elite
from qdenv.run.config import (
    CHOICES,
    RunConfig,
    check_feasible,
    choose_domain,
    choose_planner,
    follow_size,
)
from qdenv.run.directory import RunDirectory
from qdenv.run.executors.base import Execution
from qdenv.types import InputError, RepairStatus


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
    config, followed = follow_size(overridden(base, settings), base, settings)
    check_feasible(config)
    if progress and followed:
        print(followed)
    stamp = datetime.now().strftime("%Y%m%d-%H%M%S")
    name = preset if isinstance(preset, str) else "run"
    return loop.train(config, path or Path("runs") / f"{name}-{stamp}", progress, execution)


def overridden(config: RunConfig, settings: Mapping[str, Any]) -> RunConfig:
    """Replace settings of a configuration by name, however deep they lie.

    Args:
        config: the configuration.
        settings: values by name; a name of a domain, planner, generator or algorithm stands for
            its settings, with all its defaults but for what the domain shares with the old one.
            ``effort`` is that of the negotiated planner.

    Raises:
        InputError: nothing or more than one thing has this name, or the value is impossible.
    """
    # Choices first: which other names there are depends on them.
    for name in sorted(settings, key=lambda name: name not in (*CHOICES, "effort")):
        value = settings[name]
        if name == "domain" and isinstance(value, str):
            config = choose_domain(config, value)
            continue
        if name in ("effort", "planner"):
            config = choose_planner(config, settings.get("effort"), settings.get("planner"))
            continue
        if name in CHOICES and isinstance(value, str):
            value = CHOICES[name].config(value)
        homes = _homes(config, name)
        if not homes:
            known = sorted(set(_names(config)))
            near = difflib.get_close_matches(name, known, 3) or known
            raise InputError(f"there is no setting {name!r}: did you mean {', '.join(near)}?")
        if len(homes) > 1:
            records = " or ".join(home[-1] for home in homes)
            raise InputError(f"several records hold a setting {name!r}: give a whole {records}")
        config = _replaced(config, homes[0], name, value)
    return config


def _homes(record: Any, name: str) -> list[tuple[str, ...]]:
    """List the ways, field by field, to the records inside of one that hold a field `name`."""
    inside = {field.name: getattr(record, field.name) for field in dataclasses.fields(record)}
    return [()] * (name in inside) + [
        (place, *way)
        for place, inner in inside.items()
        if dataclasses.is_dataclass(inner)
        for way in _homes(inner, name)
    ]


def _replaced(record: Any, way: Sequence[str], name: str, value: Any) -> Any:
    """Replace a field of the record to which a way leads."""
    if way:
        name, value = way[0], _replaced(getattr(record, way[0]), way[1:], name, value)
    return dataclasses.replace(record, **{name: value})


def _names(record: Any) -> Iterator[str]:
    for field in dataclasses.fields(record):
        yield field.name
        inner = getattr(record, field.name)
        if dataclasses.is_dataclass(inner):
            yield from _names(inner)


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
