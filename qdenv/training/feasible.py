"""Searches that cannot succeed, refused before they begin."""

from __future__ import annotations

from qdenv.domains.base import Domain, make_domain
from qdenv.io.layouts import MAX_SIDE
from qdenv.repair.rules import impossible
from qdenv.search.axes import check_measures
from qdenv.training.config import RunConfig
from qdenv.training.following import limit_of
from qdenv.types import InputError, Rules


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
