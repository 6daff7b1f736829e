"""Configurations with another domain, planner or algorithm, chosen by name."""

import dataclasses
from typing import Any

from qdenv.domains.base import DOMAINS, make_domain
from qdenv.generate.generator import GENERATORS
from qdenv.search.registry import ALGORITHMS
from qdenv.simulate.mapf.choosing import find_planner
from qdenv.training.config import RunConfig
from qdenv.types import InputError


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
