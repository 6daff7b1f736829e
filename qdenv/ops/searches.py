"""Operations that search: the presets, a new run, a run continued."""

from __future__ import annotations

import dataclasses
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import tyro
from tyro.constructors import PrimitiveConstructorSpec

from qdenv.domains.base import DOMAINS, find_domain, make_domain
from qdenv.ops.agents import is_agent_run, resume_agent
from qdenv.ops.costs import describe_cost, remember
from qdenv.ops.options import OnCommandLine, PresetOptions, Run, option
from qdenv.ops.output import format_table, say
from qdenv.ops.results import Facts
from qdenv.ops.runs import plot_one
from qdenv.presets import PRESETS, find_preset
from qdenv.run.config import RunConfig, planner_of, resolve
from qdenv.run.directory import RunDirectory, find_start
from qdenv.run.executors.base import Execution
from qdenv.search.registry import ALGORITHMS
from qdenv.simulate.mapf.settings import describe_planner
from qdenv.study.plans import keep_from
from qdenv.types import InputError
from qdenv.zoo import PREFIX

_COLUMNS = ("preset", "domain", "algorithm", "size", "agents", "steps", "evaluations", "takes")
# Name of a preset, or a whole configuration.
Preset: TypeAlias = Annotated[
    Any,
    tyro.conf.Positional,
    PrimitiveConstructorSpec(
        nargs=1,
        metavar="{" + ",".join(PRESETS) + "}",
        instance_from_str=lambda words: words[0],
        is_instance=lambda value: isinstance(value, str),
        str_from_instance=lambda name: [name],
        choices=tuple(PRESETS),
    ),
]
Folder: TypeAlias = Annotated[
    str | Path | None,
    tyro.conf.arg(name="out", aliases=("--run-dir",)),
    option("FOLDER", Path),
]


def presets() -> Facts:
    """List the presets: what they search, and how long that takes on this machine."""
    table = [_facts_of(name, config) for name, config in PRESETS.items()]
    say(*format_table([_COLUMNS, *([row[name] for name in _COLUMNS] for row in table)]))
    say("agents: robots in a simulation; steps: its timesteps; evaluations: layouts simulated")
    sizes = []
    for name in dict.fromkeys(str(row["domain"]) for row in table):
        domain = find_domain(name)
        for (rows, cols), size in domain.known.items():
            agents = {"agents": size.agents} if domain.simulator.tasks else {}
            steps = {"timesteps": size.timesteps, "steps of growth": size.steps}
            place: dict[str, Any] = {"domain": name, "size": f"{rows} x {cols}"}
            sizes.append(place | dict(size.numbers) | agents | steps)
    say("", "sizes with numbers of their own, which commands take there unless others are stated:")
    for row in sizes:
        numbers = ", ".join(f"{value} {name}" for name, value in list(row.items())[2:])
        say(f"  {row['domain']}, {row['size']}: {numbers}")
    return Facts({"presets": table, "sizes": sizes, "settings": {}})


def _facts_of(name: str, config: RunConfig) -> dict[str, Any]:
    """Return the numbers of a preset that a person chooses by."""
    domain = config.evaluation.domain
    return {
        "preset": name,
        "domain": DOMAINS.name_of(domain),
        "size": f"{domain.rows} x {domain.cols}",
        "agents": domain.fleet.agents if domain.fleet else 1,
        "steps": domain.horizon,
        "evaluations": config.evaluations,
        "takes": describe_cost(name, config) or "not known",
        "alpha": config.evaluation.alpha,
        "algorithm": ALGORITHMS.name_of(config.algorithm),
        "simulations": config.evaluation.simulations,
    }


def train(
    preset: Preset = "quick",
    path: Folder = None,
    progress: bool = True,
    execution: Annotated[Execution, tyro.conf.arg(name="")] = Execution(),  # noqa: B008 (frozen)
    keep: Path | None = None,
    pictures: tyro.conf.Suppress[OnCommandLine] = False,
    **settings: Annotated[Any, PresetOptions],
) -> RunDirectory:
    """Search generators of floor plans: a preset, any setting of which can be overridden.

    Args:
        preset: where to begin; `qdenv presets` lists what each searches and how long that takes.
        path: folder of the run; a fresh one under runs/ unless given.
        progress: show a progress bar.
        execution: where layouts are repaired and simulated; the result is the same everywhere.
        keep: drawing of the layouts' shape: ? is free, a tile must be this tile in all of them.
        pictures: draw the run when it ends, as the command does.
        **settings: in place of the preset's, by the names of `qdenv train --help` with
            underscores: evaluations=300, seed=3, alpha=1.0, agents=40, shelves=60. Domains,
            planners, generators and algorithms may be named, or given as settings:
            planner="pbs", planner=PbsConfig(rule="plain"). What is not stated follows the size:
            numbers of tiles, agents, steps and axes.

    Returns:
        the run.

    Raises:
        InputError: a name is unknown, a setting is impossible, or the folder holds a run already.
    """
    base = find_preset(preset) if isinstance(preset, str) else preset
    if execution.workers is not None:
        settings = {"workers": execution.workers, **settings}
    config, scaled = resolve(base, settings)
    find_start(config)  # it refuses what cannot be one before anything is logged
    workers = config.evaluation.repair.workers
    execution = dataclasses.replace(execution, workers=workers)
    if keep is not None:
        kept = keep_from(keep, make_domain(config.evaluation.domain))
        evaluation = dataclasses.replace(config.evaluation, domain=kept.config)
        config = dataclasses.replace(config, evaluation=evaluation)
    name = preset if isinstance(preset, str) else "run"
    stamp = datetime.now().strftime("%Y%m%d-%H%M%S")
    path = Path("runs") / f"{name}-{stamp}" if path is None else Path(path)
    _check_folder(path)
    if scaled:
        say(f"for this size: {scaled}")
    cost, planner = describe_cost(name, config), planner_of(config)
    who = f"; planner: {describe_planner(planner)}" if planner else ""
    say(f"{name}: {config.evaluations} evaluations into {path}{cost and f', {cost}'}{who}")
    # This imports both compilers: refusals are faster without them.
    from qdenv.run import loop

    run = loop.train(config, path, progress, execution)
    if pictures:
        plot_one(run)
    if (config.evaluation, config.algorithm) == (base.evaluation, base.algorithm):
        remember(name, run.read_metrics())
    return run


def _check_folder(path: Path) -> None:
    """Refuse a folder in which no run can begin."""
    if path.as_posix().startswith(PREFIX):
        raise InputError(f"{path}: names that begin with {PREFIX} ship with qdenv: name a folder")
    RunDirectory(path).demand_own()
    files = [place for place in (path, *path.parents) if place.exists() and not place.is_dir()]
    if files:
        raise InputError(f"{path}: {files[0]} is a file: name a folder")
    if (path / "config.json").exists():
        raise InputError(f"{path}: holds a run already; `qdenv resume {path}` continues it")


def resume(
    run: Run,
    progress: bool = True,
    evaluations: int | None = None,
    execution: Annotated[Execution, tyro.conf.arg(name="")] = Execution(),  # noqa: B008 (frozen)
    pictures: tyro.conf.Suppress[OnCommandLine] = False,
) -> RunDirectory | Path:
    """Continue a run where it stopped, of a search or of an agent's training.

    Args:
        run: folder of the run.
        progress: show a progress bar.
        evaluations: a new total, to go on beyond the configured one.
        execution: where layouts are repaired and simulated; the result is the same everywhere.
        pictures: draw the run when it ends, as the command does.

    Returns:
        the run, or the trained agent's file.

    Raises:
        InputError: there is no run, it was written by a newer version or with other settings, or
            another process is at work on it.
    """
    path = run.path if isinstance(run, RunDirectory) else Path(run)
    if is_agent_run(path):
        return resume_agent(path)
    opened = RunDirectory.open(path)
    opened.demand_own()
    total = opened.config.evaluations
    if evaluations is not None and evaluations < total:
        raise InputError(
            f"{path}: {total} evaluations are configured already: give a larger number, or leave "
            "--evaluations out"
        )
    from qdenv.run import loop  # imports both compilers

    done = loop.resume(path, progress, evaluations, execution)
    if pictures:
        plot_one(done)
    return done
