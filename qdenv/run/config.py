"""The configuration of a run: override, choose, scale, check; to JSON and back."""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from annotated_types import Interval

from qdenv.domains.base import DOMAINS, make_domain
from qdenv.generators import GENERATORS
from qdenv.io.files import damaged
from qdenv.io.layouts import MAX_SIDE
from qdenv.io.records import structured, unstructured
from qdenv.ranges import MOST, PositiveInt, Ranged
from qdenv.repairs.rules import impossible
from qdenv.search.axes import check_measures
from qdenv.search.registry import ALGORITHMS
from qdenv.settings import EvaluationConfig
from qdenv.simulation.mapf.settings import PLANNERS, find_planner
from qdenv.types import InputError, Measure

# Settings that decide how long a run takes or how far it goes, but none of its results.
WITHOUT_EFFECT = ("evaluations", "checkpoint_every", "workers", "backend")
# Settings whose type is a choice, wherever a field of this name stands.
_CHOICES = dict(domain=DOMAINS, generator=GENERATORS, planner=PLANNERS, algorithm=ALGORITHMS)
# Defaults for runs older than these settings: part of the configuration, its names, values.
_FORMER: tuple[tuple[str, tuple[str, ...], dict[str, Any]], ...] = (
    ("generator", ("nca", "guided-nca"), {"arithmetic": "float"}),
    ("domain", ("manufacturing",), {"goal_odds": "stations"}),
)


@dataclasses.dataclass(frozen=True)
class RunConfig(Ranged):
    """Everything that decides the result of a run."""

    # domain, generator and numbers of one evaluation
    evaluation: EvaluationConfig = dataclasses.field(default_factory=EvaluationConfig)
    # settings of the search; their type says which algorithm it is
    algorithm: Any = dataclasses.field(default_factory=lambda: ALGORITHMS.config("cma-mae"))
    # number of solutions to evaluate, rounded up to whole iterations
    evaluations: PositiveInt = 10_000
    # (low, high, cells) of each measure; empty for the domain's own
    archive: tuple[tuple[float, float, int], ...] = ()
    # where the search begins: the best generator of a run, one of the zoo, or the elite of a cell,
    # like runs/first, zoo:warehouse-even/calm and runs/first@12,40; by default at zeros
    start: str = ""
    # random seed of everything, 0 or more
    seed: Annotated[int, Interval(ge=-MOST, le=MOST)] = 0
    checkpoint_every: PositiveInt = 5  # most iterations between checkpoints; results are the same


def config_to_json(config: RunConfig) -> dict[str, Any]:
    """Turn a configuration into JSON-ready values, each choice by its registered name.

    Raises InputError if the type of a setting is not registered.
    """
    return unstructured(config, _CHOICES)


def config_from_json(content: dict[str, Any], source: Path) -> RunConfig:
    """Read what `config_to_json` wrote.

    Raises InputError, which names `source`, if a setting is unknown or of the wrong type.
    """
    evaluation = content.get("evaluation")
    if not isinstance(evaluation, dict):
        raise damaged(source, "no configuration of a run: evaluation is missing")
    # Defaults for what older files do not state.
    for part, names, former in _FORMER:
        settings = evaluation.get(part)
        if isinstance(settings, dict) and settings.get("name") in names:
            evaluation = evaluation | {part: former | settings}
    content = content | {"evaluation": evaluation}
    return structured(content, RunConfig, source, infinite=True, choices=_CHOICES)


def resolve(preset: RunConfig, overrides: Mapping[str, Any]) -> tuple[RunConfig, str]:
    """Override a preset's settings by name, scale the others to the size, check the result.

    Returns the configuration, and a list of what was scaled ("" for nothing). Raises InputError if
    a name is unknown, a setting is impossible, or no layout could count.
    """
    # A planner's settings may be named like others, which are scaled.
    names = {name.rpartition("__")[2] for name in overrides if "planner__" not in name}
    config, scaled = scale(override(preset, overrides), preset, names)
    check(config)
    return config, scaled


def override(config: RunConfig, settings: Mapping[str, Any]) -> RunConfig:
    """Replace settings of a configuration by name, wherever they are nested.

    Settings are values by name, or by the fields that lead to one, joined by two underscores
    (``evaluation__repair__gap``). The name of a domain, planner, generator or algorithm stands for
    its settings, with all its defaults but for what a domain or generator shares with the old one;
    ``effort`` is that of the negotiated planner. Raises InputError if nothing or more than one
    thing has this name, or the value is impossible.
    """
    values: dict[tuple[str, ...], Any] = {}
    # Choices first: which other names there are depends on them.
    for name in sorted(settings, key=lambda name: name not in (*_CHOICES, "effort")):
        value = settings[name]
        choose = {"domain": choose_domain, "generator": choose_generator}.get(name)
        if choose and isinstance(value, str):
            config = choose(config, value)
            continue
        if name in ("effort", "planner"):
            config = choose_planner(config, settings.get("effort"), settings.get("planner"))
            continue
        if name in _CHOICES:
            value = _CHOICES[name].config(value) if isinstance(value, str) else value
            _CHOICES[name].name_of(value)  # refuses what is not registered
        every = list(_field_paths(config))
        paths = [tuple(name.split("__"))] if "__" in name else [p for p in every if p[-1] == name]
        if not paths:
            known = sorted({path[-1] for path in every})
            likely = "agents" if name == "robots" else name
            near = difflib.get_close_matches(likely, known, 3) or known
            raise InputError(f"there is no setting {name!r}: did you mean {', '.join(near)}?")
        if len(paths) > 1:
            records = " or ".join(path[-2] for path in paths)
            raise InputError(f"several records have a setting {name!r}: give a whole {records}")
        if "__" in name:  # from a command line: checked together
            values[paths[0]] = value
        else:
            config = _replaced(config, {paths[0]: value})
    return _replaced(config, values)


def _field_paths(record: Any) -> Iterator[tuple[str, ...]]:
    """Iterate over the settings in a record and in nested ones, as the fields that lead there."""
    for field in dataclasses.fields(record):
        yield (field.name,)
        inner = getattr(record, field.name)
        if dataclasses.is_dataclass(inner):
            yield from ((field.name, *path) for path in _field_paths(inner))


def _replaced(record: Any, values: Mapping[tuple[str, ...], Any]) -> Any:
    """Replace settings of a record and of nested ones; those of one record are checked together."""
    fields = dataclasses.fields(record) if dataclasses.is_dataclass(record) else ()
    for name, *_ in values:
        if all(name != one.name for one in fields):
            raise InputError(f"{type(record).__name__} has no setting {name!r}")
    own = {path[0]: value for path, value in values.items() if len(path) == 1}
    # A whole record may be given beside single settings of it, which then replace the record's.
    for name in {path[0] for path in values if len(path) > 1}:
        nested = {path[1:]: one for path, one in values.items() if path[0] == name and path[1:]}
        own[name] = _replaced(own.get(name, getattr(record, name)), nested)
    return replace(record, **own)


def choose_domain(config: RunConfig, name: str) -> RunConfig:
    """Put another domain into a configuration, with what the old one states beyond its defaults."""
    old, kind = make_domain(config.evaluation.domain), DOMAINS.entry(name).config
    ours, usual = vars(old.config), vars(type(old.config)())
    shared = {field.name for field in dataclasses.fields(kind)} & ours.keys()
    stated = {name: ours[name] for name in shared if ours[name] != usual[name]}
    new = make_domain(kind(**stated))
    # Ranges of the archive that were stated for other measures mean nothing here.
    alike = [one.name for one in old.measures] == [one.name for one in new.measures]
    evaluation = replace(config.evaluation, domain=new.config)
    return replace(config, evaluation=evaluation, archive=config.archive if alike else ())


def choose_planner(config: RunConfig, effort: str | None, planner: Any) -> RunConfig:
    """Put another planner (its name, or its settings) into a configuration.

    `effort` is that of the negotiated planner, low unless given; with neither, nothing changes.
    Raises InputError if a name is unknown, or no fleet drives in the domain.
    """
    if effort is None and planner is None:
        return config
    if config.evaluation.domain.fleet is None:
        raise InputError("no fleet drives in this domain: leave effort and planner out")
    chosen = find_planner(effort, planner or "", usual="low")
    return _replaced(config, {("evaluation", "domain", "fleet", "planner"): chosen})


def planner_of(config: RunConfig) -> Any:
    """Return the settings of the planner in a configuration; None if no fleet drives."""
    return getattr(config.evaluation.domain.fleet, "planner", None)


def choose_generator(config: RunConfig, name: str) -> RunConfig:
    """Put another generator into a configuration, with the settings that it shares with the old."""
    old, kind = config.evaluation.generator, GENERATORS.entry(name).config
    shared = {field.name for field in dataclasses.fields(kind)} & vars(old).keys()
    generator = kind(**{name: getattr(old, name) for name in shared})
    return replace(config, evaluation=replace(config.evaluation, generator=generator))


def choose_algorithm(config: RunConfig, algorithm: Any) -> RunConfig:
    """Put an algorithm (its settings, or its name) into a configuration, with a generator for it.

    No setting of the old algorithm is preserved: those of one name, like learning rates, mean
    different things. Most algorithms search whatever numbers a generator takes; one whose settings
    name an ``encoding`` needs the generator of that name, which others cannot use.
    """
    if isinstance(algorithm, str):
        algorithm = ALGORITHMS.config(algorithm)
    old = GENERATORS.name_of(config.evaluation.generator)
    new = getattr(algorithm, "encoding", "nca" if old == "direct" else old)
    evaluation = config.evaluation
    if new != old:
        evaluation = replace(evaluation, generator=GENERATORS.config(new))
    return replace(config, evaluation=evaluation, algorithm=algorithm)


def scale(config: RunConfig, base: RunConfig, given: Collection[str]) -> tuple[RunConfig, str]:
    """Scale with the size of the layouts what was not stated.

    Numbers of tiles, agents and a maze's timesteps grow with the generated area, steps of growth
    with the side that grows most, an axis with the number that its measure cannot exceed; at a size
    that the domain knows all but axes are what it knows. `base` is the configuration that this one
    was made from, whose numbers belong to its own size; the settings named in `given` stay. Returns
    the configuration, and a list of what was scaled ("" for nothing).
    """
    before = settings = config.evaluation.domain
    old = make_domain(base.evaluation.domain)
    if type(settings) is not type(old.config):  # another domain: its numbers at the old size
        old = make_domain(replace(settings, rows=old.config.rows, cols=old.config.cols))
    stated = {name: getattr(settings, name) for name in old.counted if name in given}
    if old.shape == (settings.rows, settings.cols) and stated == {}:
        return config, ""
    new = old.resized(settings.rows, settings.cols, stated)
    size = old.known_size(*new.shape)
    ratio = max(new.area, 1) / max(old.area, 1)
    settings = replace(settings, **new.numbers).scaled(ratio, size, given)
    new = make_domain(settings)
    changes = [
        f"{value} {name}" for name, value in new.numbers.items() if getattr(before, name) != value
    ]
    if before.fleet != settings.fleet:
        changes.append(f"{settings.fleet.agents} agents")
    if before.horizon != settings.horizon:
        changes.append(f"{settings.horizon} timesteps")
    generator = config.evaluation.generator
    if hasattr(generator, "steps") and "steps" not in given and new.shape != old.shape:
        longer = max(new.shape[0] / old.shape[0], new.shape[1] / old.shape[1])
        steps = size.steps if size else max(1, round(generator.steps * longer))
        if steps != generator.steps:
            generator = replace(generator, steps=steps)
            changes.append(f"{steps} steps of growth")
    archive = config.archive
    if "archive" not in given:
        axes = archive or [axis[1:4] for axis in old.measures]
        limits = [(old.limit_of(axis), new.limit_of(axis)) for axis in old.measures]
        growths = [after / before if before and after else 1.0 for before, after in limits]
        archive = tuple(
            (low * growth, high * growth, cells)
            for (low, high, cells), growth in zip(axes, growths, strict=True)
        )
    if archive != config.archive:
        changes += [
            f"{axis.name} from {low:.0f} to {high:.0f}"  # a count
            for axis, (low, high, _) in zip(new.measures, archive, strict=True)
            if axis.limit
        ]
    evaluation = replace(config.evaluation, domain=settings, generator=generator)
    return replace(config, evaluation=evaluation, archive=archive), ", ".join(changes)


def check(config: RunConfig) -> None:
    """Refuse a search none of whose layouts could count; nothing is compiled for that.

    Raises InputError if no layout obeys the rules, the agents do not fit, or an axis of the archive
    lies where no layout of this size is.
    """
    settings = config.evaluation.domain
    rows, cols = settings.rows, settings.cols
    if not (1 <= rows <= MAX_SIDE and 1 <= cols <= MAX_SIDE):
        raise InputError(f"a layout of {rows} x {cols}: choose 1 to {MAX_SIDE} rows and columns")
    if config.seed < 0:  # `RunConfig` takes them, as old runs may have one
        raise InputError(f"seed {config.seed}: give 0 or more")
    domain = make_domain(settings)
    if min(domain.generated_shape) < 1:
        raise InputError(f"{rows} x {cols} leaves no room inside the frame: give a larger size")
    domain.demand_plan()
    draws = getattr(config.evaluation.generator, "draws", True)
    rules = domain.rules() if domain.rules and draws else None
    if rules and (reason := impossible(rules)):
        raise InputError(f"no layout of {rows} x {cols} obeys the rules: {reason}")
    tasks, fleet = domain.simulator.tasks, settings.fleet
    if rules and tasks and fleet:
        # Tiles that must be there and that no agent drives on leave this many cells at most.
        drivable = set(tasks.traversable)
        blocked = sum(bound.low for bound in rules.counts if not drivable & set(bound.tiles))
        free = rows * cols - blocked
        if fleet.agents > free:
            room = f"at most {free} free cells; start with a quarter of that, {free // 4}"
            raise InputError(f"{fleet.agents} agents do not fit: {rows} x {cols} has {room}")
    for axis in archive_axes(domain.measures, config.archive):
        most = domain.limit_of(axis)
        if (most is not None and axis.low >= most) or axis.high <= 0:
            reach = "have more than 0" if most is None else f"reach 0 to {most:g}"
            runs = f"axis {axis.name!r} runs from {axis.low:g} to {axis.high:g}"
            cure = "leave --archive out, or give a range within"
            cure = f"give more {axis.limit}" if most == 0 else cure
            raise InputError(f"{runs}, but layouts of {rows} x {cols} {reach}: {cure}")


def archive_axes(
    measures: Sequence[Measure], ranges: Sequence[tuple[float, float, int]]
) -> tuple[Measure, ...]:
    """Give measures the configured ranges (low, high, cells), or their own where there are none."""
    ranges = ranges or [axis[1:4] for axis in measures]
    if len(ranges) != len(measures):
        names = " and ".join(axis.name for axis in measures)
        those = f"{names}; write --archive LOW HIGH CELLS for each of them, one after the other"
        raise InputError(f"{len(ranges)} axes given: this archive has {len(measures)}, {those}")
    axes = tuple(
        axis._replace(low=low, high=high, cells=cells)
        for axis, (low, high, cells) in zip(measures, ranges, strict=True)
    )
    check_measures(axes)
    return axes
