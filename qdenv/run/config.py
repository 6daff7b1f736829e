"""The configuration of a run, and its way to JSON and back."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection
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
from qdenv.simulate.mapf.choosing import find_planner
from qdenv.simulate.mapf.settings import PLANNERS
from qdenv.types import InputError, Measure, Rules

# Settings whose type is a choice, wherever a field of this name stands.
CHOICES = {
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
    content: dict[str, Any] = unstructured(config, CHOICES)
    return content


def config_from_json(content: dict[str, Any], source: Path) -> RunConfig:
    """Read what `config_to_json` wrote.

    Raises:
        InputError: a setting is unknown, missing or of the wrong type; the line names it and
            `source`.
    """
    if not isinstance(content.get("evaluation"), dict):
        raise damaged(source, "no configuration of a run: evaluation is missing")
    return structured(content, RunConfig, source, infinite=True, choices=CHOICES)


def choose_domain(config: RunConfig, name: str) -> RunConfig:
    """Put another domain into a configuration, at the size and with the numbers it states.

    Raises:
        InputError: the name is unknown.
    """
    old = make_domain(config.evaluation.domain)
    new = make_domain(recast(old.config, DOMAINS.entry(name).config))
    # Ranges of the archive that were stated for other measures mean nothing here.
    alike = [one.name for one in old.measures] == [one.name for one in new.measures]
    evaluation = dataclasses.replace(config.evaluation, domain=new.config)
    archive = config.archive if alike else ()
    return dataclasses.replace(config, evaluation=evaluation, archive=archive)


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
    if not hasattr(domain, "fleet"):
        raise InputError("no fleet drives in this domain: leave effort and planner out")
    chosen = find_planner(effort, planner or "", usual="low")
    domain = dataclasses.replace(domain, fleet=dataclasses.replace(domain.fleet, planner=chosen))
    return dataclasses.replace(
        config, evaluation=dataclasses.replace(config.evaluation, domain=domain)
    )


def planner_of(config: RunConfig) -> Any:
    """Find the settings of the planner in a configuration; None where no fleet drives."""
    fleet = getattr(config.evaluation.domain, "fleet", None)
    return None if fleet is None else fleet.planner


def choose_algorithm(config: RunConfig, name: str) -> RunConfig:
    """Put another algorithm with all its defaults into a configuration.

    Nothing is carried over: settings of one name, like learning rates, mean different things.

    Raises:
        InputError: the name is unknown.
    """
    return with_algorithm(config, ALGORITHMS.config(name))


def with_algorithm(config: RunConfig, algorithm: Any) -> RunConfig:
    """Put an algorithm into a configuration, with the generator that it searches.

    Most search whatever numbers a generator takes; one whose settings name an ``encoding`` needs
    the generator of that name, which others cannot use.

    Args:
        config: the configuration.
        algorithm: settings of a registered algorithm.
    """
    now = GENERATORS.name_of(config.evaluation.generator)
    wanted = getattr(algorithm, "encoding", "nca" if now == "direct" else now)
    evaluation = config.evaluation
    if wanted != now:
        evaluation = dataclasses.replace(evaluation, generator=GENERATORS.config(wanted))
    return dataclasses.replace(config, evaluation=evaluation, algorithm=algorithm)


def recast(settings: Any, kind: type) -> Any:
    """Carry what `settings` states beyond its type's defaults over to settings of another type."""
    usual, known = type(settings)(), {field.name for field in dataclasses.fields(kind)}
    stated = {
        field.name: getattr(settings, field.name)
        for field in dataclasses.fields(settings)
        if getattr(settings, field.name) != getattr(usual, field.name)
    }
    return kind(**{name: value for name, value in stated.items() if name in known})


def follow_size(
    config: RunConfig, base: RunConfig, given: Collection[str]
) -> tuple[RunConfig, str]:
    """Let what nobody stated follow the size of the layout.

    Numbers of tiles and agents grow with the generated area, steps of growth with the longer side,
    an axis with the number that its measure cannot exceed; at a size that the domain knows the
    first three are what it knows.

    Args:
        config: the configuration, of whatever size.
        base: the one it was made from, whose numbers belong to its own size.
        given: names of the settings that were stated and stay as they are.

    Returns:
        the configuration, and what followed, in words ("" where nothing did).
    """
    asked = config.evaluation.domain
    old = make_domain(base.evaluation.domain)
    if type(asked) is not type(old.config):
        old = make_domain(dataclasses.replace(asked, rows=old.config.rows, cols=old.config.cols))
    stated = {name: getattr(asked, name) for name in old.counted if name in given}
    if old.shape == (asked.rows, asked.cols) and stated == {}:
        return config, ""
    new = old.resized(asked.rows, asked.cols, stated)
    ratio = _area(new) / _area(old)
    settings = dataclasses.replace(asked, **new.numbers)
    size = old.known_size(*new.shape)
    settings = settings.for_known(size, given) if size else settings.for_area(ratio, given)
    new = make_domain(settings)
    generator = config.evaluation.generator
    longer = max(new.shape[0] / old.shape[0], new.shape[1] / old.shape[1])
    if hasattr(generator, "steps") and "steps" not in given and new.shape != old.shape:
        steps = size.steps if size else max(1, round(generator.steps * longer))
        generator = dataclasses.replace(generator, steps=steps)
    archive = config.archive
    if "archive" not in given:
        axes = config.archive or [(axis.low, axis.high, axis.cells) for axis in old.measures]
        archive = tuple(
            (low * _growth(axis, old, new), high * _growth(axis, old, new), cells)
            for axis, (low, high, cells) in zip(old.measures, axes, strict=True)
        )
    evaluation = dataclasses.replace(config.evaluation, domain=settings, generator=generator)
    followed = dataclasses.replace(config, evaluation=evaluation, archive=archive)
    return followed, _in_words(config, followed, new)


def limit_of(measure: Measure, domain: Domain) -> float | None:
    """Find the number that a measure cannot exceed in layouts of a domain; None for no such."""
    if not measure.limit:
        return None
    return _area(domain) if measure.limit == "area" else getattr(domain.config, measure.limit)


def _area(domain: Domain) -> int:
    rows, cols = domain.generated_shape
    return max(rows * cols, 1)


def _growth(measure: Measure, old: Domain, new: Domain) -> float:
    before, after = limit_of(measure, old), limit_of(measure, new)
    return after / before if before and after else 1.0


def _in_words(before: RunConfig, after: RunConfig, domain: Domain) -> str:
    """List what is other than before."""
    old, new = before.evaluation, after.evaluation
    said = [
        f"{value} {name}"
        for name, value in domain.numbers.items()
        if getattr(old.domain, name) != value
    ]
    fleets: list[Any] = [getattr(one.domain, "fleet", None) for one in (old, new)]
    if fleets[0] != fleets[1]:
        said.append(f"{fleets[1].agents} agents")
    horizons: list[Any] = [getattr(one.domain, "timesteps", None) for one in (old, new)]
    if horizons[0] != horizons[1]:
        said.append(f"{horizons[1]} timesteps")
    steps: list[Any] = [getattr(one.generator, "steps", None) for one in (old, new)]
    if steps[0] != steps[1]:
        said.append(f"{steps[1]} steps of growth")
    if before.archive != after.archive:
        said += [
            f"{axis.name} from {low:g} to {high:g}"
            for axis, (low, high, _) in zip(domain.measures, after.archive, strict=True)
            if axis.limit
        ]
    return ", ".join(said)


def check_feasible(config: RunConfig) -> None:
    """Refuse a search none of whose layouts could count; takes no compiler.

    Raises:
        InputError: no layout obeys the rules, the agents do not fit, or an axis of the archive
            lies where no layout of this size is.
    """
    settings = config.evaluation.domain
    if not (1 <= settings.rows <= MAX_SIDE and 1 <= settings.cols <= MAX_SIDE):
        size = f"{settings.rows} x {settings.cols}"
        raise InputError(f"a layout of {size}: choose 1 to {MAX_SIDE} rows and columns")
    if config.seed < 0:  # an older qdenv took them, so a run may have one
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
    tasks, fleet = domain.simulator.tasks, getattr(domain.config, "fleet", None)
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
        most = limit_of(axis, domain)
        if (most is not None and low >= most) or high <= 0:
            rows, cols = domain.shape
            raise InputError(
                f"axis {axis.name!r} runs from {low:g} to {high:g}, but layouts of {rows} x {cols} "
                f"reach 0 to {most:g}: leave --archive out, or give a range within"
            )
    check_measures(
        [axis._replace(cells=one[2]) for axis, one in zip(measures, ranges, strict=True)]
    )
