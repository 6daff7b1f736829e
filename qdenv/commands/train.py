"""The command train: a preset, what is chosen by name, and what follows from the size."""

import functools
import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from qdenv.commands.arguments import take
from qdenv.commands.choices import Effort, names_of
from qdenv.commands.costs import describe_cost, remember
from qdenv.commands.keeping import choose_keep
from qdenv.commands.planners import check_options
from qdenv.domains.base import DOMAINS
from qdenv.presets import PRESETS, find_preset
from qdenv.run.config import (
    RunConfig,
    check,
    choose_algorithm,
    choose_domain,
    choose_planner,
    planner_of,
    scale,
)
from qdenv.run.directory import RunDirectory, find_start
from qdenv.run.executors.base import Execution, ExecutorName
from qdenv.search.registry import ALGORITHMS
from qdenv.search.settings import check_strategy
from qdenv.simulate.mapf.choosing import describe_planner
from qdenv.simulate.mapf.settings import PLANNERS
from qdenv.types import InputError
from qdenv.zoo import PREFIX

FIRST = "quick"  # the preset where none is named


@dataclass(frozen=True)
class Setup:
    """What is searched, and where the run goes."""

    config: RunConfig  # the preset's settings
    # another domain in place of the preset's, at its size
    domain: Annotated[str | None, tyro.conf.arg(metavar=names_of(DOMAINS))] = None
    # of the negotiated planner: low inside a search, high for numbers to report
    effort: Effort = None
    # another planner, with its defaults; what it can be told is listed below
    planner: Annotated[str | None, tyro.conf.arg(metavar=names_of(PLANNERS))] = None
    # another search algorithm, with its defaults
    algorithm: Annotated[str | None, tyro.conf.arg(metavar=names_of(ALGORITHMS))] = None
    # folder of the run; a fresh one under runs/ unless given
    out: Annotated[Path | None, tyro.conf.arg(aliases=("--run-dir",))] = None
    # drawing of the layouts' shape: ? is free, a tile must be this tile in all of them
    keep: Path | None = None
    # who repairs and simulates layouts: threads of this process, or a Dask cluster; on this machine
    # with --workers processes, or
    executor: ExecutorName = "threads"
    # where the scheduler of a running cluster answers, like tcp://10.0.0.1:8786
    scheduler: str | None = None
    progress: bool = True  # show a progress bar


def train(preset: str, setup: Setup, given: frozenset[str] = frozenset()) -> None:
    """Search generators of floor plans: a preset, any setting of which can be overridden.

    Args:
        preset: where to begin.
        setup: what is searched, and where the run goes.
        given: names of the settings that the command line states; others follow the size.
    """
    config, scaled = scale(setup.config, find_preset(preset), given)
    check(config)
    find_start(config)  # it refuses what cannot be one before anything is said
    workers = config.evaluation.repair.workers
    execution = Execution(setup.executor, setup.scheduler, workers)
    if setup.keep is not None:
        config = choose_keep(config, setup.keep)
    stamp = datetime.now().strftime("%Y%m%d-%H%M%S")
    path = setup.out or Path("runs") / f"{preset}-{stamp}"
    if path.as_posix().startswith(PREFIX):
        raise InputError(f"{path}: names that begin with {PREFIX} ship with qdenv: name a folder")
    RunDirectory(path).demand_own()
    files = [place for place in (path, *path.parents) if place.exists() and not place.is_dir()]
    if files:
        raise InputError(f"{path}: {files[0]} is a file: name a folder")
    if (path / "config.json").exists():
        raise InputError(f"{path}: holds a run already; `qdenv resume {path}` continues it")
    if scaled:
        print(f"for this size: {scaled}")
    cost, planner = describe_cost(preset, config), planner_of(config)
    who = f"; planner: {describe_planner(planner)}" if planner else ""
    print(f"{preset}: {config.evaluations} evaluations into {path}{cost and f', {cost}'}{who}")
    # Only now: what is above answers at once, and these import both compilers.
    from qdenv.commands.runs import report
    from qdenv.run import loop

    run = loop.train(config, path, setup.progress, execution)
    report(run)
    usual = find_preset(preset)
    if (config.evaluation, config.algorithm) == (usual.evaluation, usual.algorithm):
        remember(preset, run.read_metrics())


def bind(command: Callable, arguments: Sequence[str]) -> Callable:
    """Give the command its options: which there are depends on what is chosen by name.

    Args:
        command: `train`.
        arguments: the command line after its name.

    Raises:
        InputError: a preset or a name is unknown.
    """
    named = bool(arguments) and not arguments[0].startswith("-")
    preset = arguments[0] if named else FIRST
    config, rest = find_preset(preset), list(arguments[named:])
    # Chosen before the options are listed, which the choices decide.
    for option, choose in {"--domain": choose_domain, "--algorithm": choose_algorithm}.items():
        name, rest = take(rest, option)
        config = config if name is None else choose(config, name)
    effort, rest = take(rest, "--effort")
    planner, rest = take(rest, "--planner")
    config = choose_planner(config, effort, planner)
    check_options(rest, planner_of(config))
    check_strategy(take(rest, "--strategy")[0] or "")  # the parser would not say why
    given = frozenset(
        word.partition("=")[0].lstrip("-").replace("-", "_") for word in rest if word[:2] == "--"
    )

    @functools.wraps(command)
    def bound(preset: str = preset, setup: Setup = Setup(config)) -> Any:
        return command(preset, setup, given)

    names = Literal[tuple(PRESETS)]  # type: ignore[valid-type]
    hints: dict[str, Any] = {
        "preset": Annotated[names, tyro.conf.Positional, tyro.conf.arg(help=_costs())],
        "setup": Annotated[Setup, tyro.conf.OmitArgPrefixes, tyro.conf.arg(name="")],
    }
    parameters = [
        inspect.Parameter(
            name, inspect.Parameter.POSITIONAL_OR_KEYWORD, annotation=hint, default=default
        )
        for (name, hint), default in zip(hints.items(), (preset, Setup(config)), strict=True)
    ]
    del bound.__wrapped__
    bound.__annotations__ = hints
    bound.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    return bound


def _costs() -> str:
    """Say what each preset takes, for help."""
    costs = {name: describe_cost(name, config) for name, config in PRESETS.items()}
    return "where to begin: " + "; ".join(f"{name}, {cost}" for name, cost in costs.items())
