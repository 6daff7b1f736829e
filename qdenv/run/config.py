"""The configuration of a run: override, choose, scale, check; to JSON and back."""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from annotated_types import Interval

from qdenv.domains.base import DOMAINS, Domain, make_domain
from qdenv.generate import GENERATORS
from qdenv.io.files import damaged
from qdenv.io.layouts import MAX_SIDE
from qdenv.io.records import structured, unstructured
from qdenv.ranges import MOST, PositiveInt, Ranged
from qdenv.repair.rules import impossible
from qdenv.search.axes import check_measures
from qdenv.search.registry import ALGORITHMS
from qdenv.settings import EvaluationConfig
from qdenv.simulate.mapf.settings import PLANNERS, find_planner
from qdenv.types import InputError, Measure, Rules

# Settings whose type is a choice, wherever a field of this name stands.
_CHOICES = {
    "domain": DOMAINS,
    "generator": GENERATORS,
    "planner": PLANNERS,
    "algorithm": ALGORITHMS,
}


@dataclasses.dataclass(frozen=True)
class RunConfig(Ranged):
    """Everything that decides the result of a run."""

    # domain, generator and numbers of one evaluation
    evaluation: EvaluationConfig = dataclasses.field(default_factory=EvaluationConfig)
    # settings of the search; their type says which algorithm it is
    algorithm: Any = dataclasses.field(default_factory=lambda: ALGORITHMS.config("cma-mae"))
    # how many solutions are evaluated, rounded up to whole iterations
    evaluations: PositiveInt = 10_000
    # (low, high, cells) of each measure; empty for the domain's own
    archive: tuple[tuple[float, float, int], ...] = ()
    # generator from which the search begins: the best of a run or one of the zoo (runs/first,
    # zoo:warehouse-even/calm), or the elite of a cell (runs/first@12,40); zeros where empty
    start: str = ""
    # the one random seed; new runs take none below 0
    seed: Annotated[int, Interval(ge=-MOST, le=MOST)] = 0
    checkpoint_every: PositiveInt = 5  # iterations between checkpoints; decides no result


def config_to_json(config: RunConfig) -> dict[str, Any]:
    """Resolve a configuration to JSON-ready values, each choice by its registered name.

    Raises:
        InputError: the type of a setting is not registered.
    """
    content: dict[str, Any] = unstructured(config, _CHOICES)
    return content


def config_from_json(content: dict[str, Any], source: Path) -> RunConfig:
    """Read what `config_to_json` wrote.

    Raises:
        InputError: a setting is unknown, missing or of the wrong type; the line names it and
            `source`.
    """
    if not isinstance(content.get("evaluation"), dict):
        raise damaged(source, "no configuration of a run: evaluation is missing")
    return structured(content, RunConfig, source, infinite=True, choices=_CHOICES)


def resolve(preset: RunConfig, overrides: Mapping[str, Any]) -> tuple[RunConfig, str]:
    """Resolve a configuration: override a preset's settings, scale the others, check the result.

    Args:
        preset: whose numbers belong to its own size.
        overrides: settings by name, as `override` takes them.

    Returns:
        the configuration, and a list of what was scaled ("" for nothing).

    Raises:
        InputError: a name is unknown, a setting is impossible, or no layout could count.
    """
    # A planner's settings may be named like others, which are scaled.
    names = {name.rpartition("__")[2] for name in overrides if "planner__" not in name}
    config, scaled = scale(override(preset, overrides), preset, names)
    check(config)
    return config, scaled


def override(config: RunConfig, settings: Mapping[str, Any]) -> RunConfig:
    """Replace settings of a configuration by name, wherever they are nested.

    Args:
        config: the configuration.
        settings: values by name, or by the fields that lead to one, joined by two underscores
            (``evaluation__repair__gap``); a name of a domain, planner, generator or algorithm
            stands for its settings, with all its defaults but for what the domain shares with the
            old one. ``effort`` is that of the negotiated planner.

    Raises:
        InputError: nothing or more than one thing has this name, or the value is impossible.
    """
    values: dict[tuple[str, ...], Any] = {}
    # Choices first: which other names there are depends on them.
    for name in sorted(settings, key=lambda name: name not in (*_CHOICES, "effort")):
        value = settings[name]
        if name == "domain" and isinstance(value, str):
            config = choose_domain(config, value)
            continue
        if name in ("effort", "planner"):
            config = choose_planner(config, settings.get("effort"), settings.get("planner"))
            continue
        if name in _CHOICES and isinstance(value, str):
            value = _CHOICES[name].config(value)
        paths = [path for path in _field_paths(config) if path[-1] == name]
        if "__" in name:
            paths = [tuple(name.split("__"))]
        if not paths:
            known = sorted({path[-1] for path in _field_paths(config)})
            near = difflib.get_close_matches(name, known, 3) or known
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
    """Iterate over the settings in a record and its nested records, by the names on their way."""
    for field in dataclasses.fields(record):
        yield (field.name,)
        inner = getattr(record, field.name)
        if dataclasses.is_dataclass(inner):
            yield from ((field.name, *path) for path in _field_paths(inner))


def _replaced(record: Any, values: Mapping[tuple[str, ...], Any]) -> Any:
    """Replace settings of a record and of nested ones; those of one record are checked together."""
    own = {path[0]: value for path, value in values.items() if len(path) == 1}
    for name in {path[0] for path in values if len(path) > 1}:
        nested = {path[1:]: one for path, one in values.items() if path[0] == name and path[1:]}
        own[name] = _replaced(own.get(name, getattr(record, name)), nested)
    return replace(record, **own)


def choose_domain(config: RunConfig, name: str) -> RunConfig:
    """Put another domain into a configuration, with what the old one states beyond its defaults.

    Raises:
        InputError: the name is unknown.
    """
    old, kind = make_domain(config.evaluation.domain), DOMAINS.entry(name).config
    settings, defaults = old.config, type(old.config)()
    known = {field.name for field in dataclasses.fields(kind)}
    stated = {
        field.name: getattr(settings, field.name)
        for field in dataclasses.fields(settings)
        if field.name in known and getattr(settings, field.name) != getattr(defaults, field.name)
    }
    new = make_domain(kind(**stated))
    # Ranges of the archive that were stated for other measures mean nothing here.
    alike = [one.name for one in old.measures] == [one.name for one in new.measures]
    evaluation = replace(config.evaluation, domain=new.config)
    return replace(config, evaluation=evaluation, archive=config.archive if alike else ())


def choose_planner(config: RunConfig, effort: str | None, planner: Any) -> RunConfig:
    """Put another planner into a configuration; neither word given changes nothing.

    Args:
        config: the configuration.
        effort: of the negotiated planner; low unless given.
        planner: a planner's name, or its settings.

    Raises:
        InputError: a word is unknown, or no fleet drives in the domain.
    """
    if effort is None and planner is None:
        return config
    domain = config.evaluation.domain
    if domain.fleet is None:
        raise InputError("no fleet drives in this domain: leave effort and planner out")
    chosen = find_planner(effort, planner or "", usual="low")
    domain = replace(domain, fleet=replace(domain.fleet, planner=chosen))
    return replace(config, evaluation=replace(config.evaluation, domain=domain))


def planner_of(config: RunConfig) -> Any:
    """Return the settings of the planner in a configuration; None if no fleet drives."""
    fleet = config.evaluation.domain.fleet
    return None if fleet is None else fleet.planner


def choose_algorithm(config: RunConfig, algorithm: Any) -> RunConfig:
    """Put an algorithm into a configuration, with the generator that it searches.

    Nothing of the old one is preserved: settings of one name, like learning rates, mean different
    things. Most algorithms search whatever numbers a generator takes; one whose settings name an
    ``encoding`` needs the generator of that name, which others cannot use.

    Args:
        config: the configuration.
        algorithm: its settings, or its name, which stands for all its defaults.

    Raises:
        InputError: the name is unknown.
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

    Numbers of tiles and agents grow with the generated area, steps of growth with the longer side,
    an axis with the number that its measure cannot exceed; at a size that the domain knows the
    first three are what it knows.

    Args:
        config: the configuration, of whatever size.
        base: the one it was made from, whose numbers belong to its own size.
        given: names of the settings that were stated and stay.

    Returns:
        the configuration, and a list of what was scaled ("" for nothing).
    """
    settings = config.evaluation.domain
    old = make_domain(base.evaluation.domain)
    if type(settings) is not type(old.config):
        old = make_domain(replace(settings, rows=old.config.rows, cols=old.config.cols))
    stated = {name: getattr(settings, name) for name in old.counted if name in given}
    if old.shape == (settings.rows, settings.cols) and stated == {}:
        return config, ""
    new = old.resized(settings.rows, settings.cols, stated)
    ratio = _area(new) / _area(old)
    settings = replace(settings, **new.numbers)
    size = old.known_size(*new.shape)
    settings = settings.scaled(ratio, size, given)
    new = make_domain(settings)
    generator = config.evaluation.generator
    longer = max(new.shape[0] / old.shape[0], new.shape[1] / old.shape[1])
    if hasattr(generator, "steps") and "steps" not in given and new.shape != old.shape:
        steps = size.steps if size else max(1, round(generator.steps * longer))
        generator = replace(generator, steps=steps)
    archive = config.archive
    if "archive" not in given:
        axes = config.archive or [(axis.low, axis.high, axis.cells) for axis in old.measures]
        archive = tuple(
            (low * _growth(axis, old, new), high * _growth(axis, old, new), cells)
            for axis, (low, high, cells) in zip(old.measures, axes, strict=True)
        )
    evaluation = replace(config.evaluation, domain=settings, generator=generator)
    scaled = replace(config, evaluation=evaluation, archive=archive)
    return scaled, _describe_changes(config, scaled, new)


def _limit_of(measure: Measure, domain: Domain) -> float | None:
    """Return what a measure cannot exceed in layouts of a domain; None if nothing limits it."""
    if not measure.limit:
        return None
    return _area(domain) if measure.limit == "area" else getattr(domain.config, measure.limit)


def _area(domain: Domain) -> int:
    rows, cols = domain.generated_shape
    return max(rows * cols, 1)


def _growth(measure: Measure, old: Domain, new: Domain) -> float:
    before, after = _limit_of(measure, old), _limit_of(measure, new)
    return after / before if before and after else 1.0


def _describe_changes(before: RunConfig, after: RunConfig, domain: Domain) -> str:
    old, new = before.evaluation, after.evaluation
    texts = [
        f"{value} {name}"
        for name, value in domain.numbers.items()
        if getattr(old.domain, name) != value
    ]
    if old.domain.fleet != new.domain.fleet:
        texts.append(f"{new.domain.fleet.agents} agents")
    if old.domain.horizon != new.domain.horizon:
        texts.append(f"{new.domain.horizon} timesteps")
    if old.generator != new.generator:  # only its steps scale
        texts.append(f"{new.generator.steps} steps of growth")
    if before.archive != after.archive:
        texts += [
            f"{axis.name} from {low:g} to {high:g}"
            for axis, (low, high, _) in zip(domain.measures, after.archive, strict=True)
            if axis.limit
        ]
    return ", ".join(texts)


def check(config: RunConfig) -> None:
    """Refuse a search none of whose layouts could count; takes no compiler.

    Raises:
        InputError: no layout obeys the rules, the agents do not fit, or an axis of the archive
            lies where no layout of this size is.
    """
    settings = config.evaluation.domain
    if not (1 <= settings.rows <= MAX_SIDE and 1 <= settings.cols <= MAX_SIDE):
        size = f"{settings.rows} x {settings.cols}"
        raise InputError(f"a layout of {size}: choose 1 to {MAX_SIDE} rows and columns")
    if config.seed < 0:  # `RunConfig` takes them, as old runs may have one
        raise InputError(f"seed {config.seed}: give 0 or more")
    domain = make_domain(settings)
    for name, number in domain.numbers.items():
        if number < 0:
            raise InputError(f"{number} {name}: give 0 or more")
    if min(domain.generated_shape) < 1:
        rows, cols = domain.shape
        raise InputError(f"{rows} x {cols} leaves no room inside the frame: ask for more")
    if domain.rules is not None:
        _check_rules(domain, domain.rules())
    _check_axes(config, domain)


def _check_rules(domain: Domain, rules: Rules) -> None:
    rows, cols = domain.shape
    reason = impossible(rules)
    if reason:
        raise InputError(f"no layout of {rows} x {cols} obeys the rules: {reason}")
    tasks, fleet = domain.simulator.tasks, domain.config.fleet
    if tasks is None or fleet is None:
        return
    blocked = sum(
        bound.low for bound in rules.counts if not set(bound.tiles) & set(tasks.traversable)
    )
    free = rows * cols - blocked
    if fleet.agents > free:
        raise InputError(
            f"{fleet.agents} agents do not fit: layouts of {rows} x {cols} have at most {free} "
            f"free cells; a quarter of that, {free // 4}, drives well"
        )


def _check_axes(config: RunConfig, domain: Domain) -> None:
    measures = domain.measures
    if config.archive and len(config.archive) != len(measures):
        names = " and ".join(axis.name for axis in measures)
        raise InputError(
            f"{len(config.archive)} axes given: this archive has {len(measures)}, {names}; write "
            f"--archive LOW HIGH CELLS for each of them, one after the other"
        )
    ranges = config.archive or [axis[1:4] for axis in measures]
    for axis, given in zip(measures, ranges, strict=True):
        low, high, cells = given
        if not low < high or cells < 1:
            raise InputError(
                f"axis {axis.name!r}: {low:g} to {high:g} in {cells} cells is empty: give LOW < "
                "HIGH and at least one cell"
            )
        most = _limit_of(axis, domain)
        if (most is not None and low >= most) or high <= 0:
            rows, cols = domain.shape
            raise InputError(
                f"axis {axis.name!r} runs from {low:g} to {high:g}, but layouts of {rows} x {cols} "
                f"reach 0 to {most:g}: leave --archive out, or give a range within"
            )
    check_measures(
        [axis._replace(cells=one[2]) for axis, one in zip(measures, ranges, strict=True)]
    )
