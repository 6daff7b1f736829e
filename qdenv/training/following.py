"""What follows from another size: numbers of tiles, agents, steps and the axes of the archive."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection
from typing import Any

from qdenv.domains.base import Domain, make_domain
from qdenv.training.config import RunConfig
from qdenv.types import Measure


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
