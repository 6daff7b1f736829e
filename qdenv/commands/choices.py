"""Options that depend on a choice made in the same command line: whose numbers, which planner."""

import contextlib
import dataclasses
import functools
import inspect
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import tyro

from qdenv.commands.arguments import take
from qdenv.commands.planners import stated_planner
from qdenv.domains.base import DOMAINS, Domain, find_domain, make_domain
from qdenv.ranges import PositiveFloat, PositiveInt, Ranged
from qdenv.registry import Registry
from qdenv.run.directory import RunDirectory
from qdenv.simulate.mapf.choosing import OWN
from qdenv.simulate.mapf.negotiated.settings import HIGH
from qdenv.simulate.mapf.settings import PLANNERS, FleetConfig
from qdenv.study.options import TIMESTEPS
from qdenv.study.plans import USUAL, read_plan
from qdenv.types import InputError
from qdenv.zoo import PREFIX

LONGEST_NAME = 255  # bytes of a file's name


def names_of(registry: Registry) -> str:
    """List the names of a registry's choices as help shows them, like {low,high}."""
    return "{" + ",".join(registry.names()) + "}"


# What commands read, without an option, and how help calls it.
LayoutFile = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="LAYOUT")]
LayoutFiles = Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="LAYOUT ...")]
RunFolder = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
RunFolders = Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RUN ...")]

# How a command takes the name of a domain that a layout file may say itself.
DomainName = Annotated[str | None, tyro.conf.arg(metavar=names_of(DOMAINS))]

# How a command takes the effort of the negotiated planner, which others have none of.
Effort = Annotated[str | None, tyro.conf.arg(metavar="{low,high}")]


@dataclasses.dataclass(frozen=True)
class RunOptions(Ranged):
    """Who drives on a layout, and for how long."""

    domain: DomainName = None  # whose tasks the agents do; what the layout file says unless given
    # how long to simulate; 1000, or what is known of the layout's size, unless given
    timesteps: PositiveInt | None = None
    # of the negotiated planner: low for a quick look, high, for numbers to report, unless given
    effort: Effort = None
    # who plans, with the defaults below
    planner: Annotated[str, tyro.conf.arg(metavar=names_of(PLANNERS))] = OWN
    planner_settings: Annotated[Any, tyro.conf.arg(name="")] = HIGH  # of the chosen planner
    # end a run at its first congested window, as published; --no-stop goes on (Figure 17)
    stop: bool = True

    def fleet(self, agents: int) -> FleetConfig:
        """Make the numbers of a simulation.

        Raises:
            InputError: they make none.
        """
        return self.fleet_for(agents, TIMESTEPS if self.timesteps is None else self.timesteps)

    def fleet_for(self, agents: int, timesteps: int) -> FleetConfig:
        """Make the numbers of a simulation, with a horizon of this command line's or another.

        Raises:
            InputError: they make none.
        """
        return FleetConfig(
            agents,
            timesteps,
            planner=self.planner_settings,
            stop_when_congested=self.stop,
        )


@dataclasses.dataclass(frozen=True)
class FleetOptions(RunOptions):
    """Who drives on a layout, for how long, and how often."""

    # 10 for ten runs, seeds 0 to 9; 3,5,9 for these three; 7, for this one
    seeds: tuple[str, ...] = ("10",)
    seconds_per_step: PositiveFloat | None = None  # of one timestep, to report tasks per hour, too


# How a command takes them: without a prefix of their own.
OneRun = Annotated[RunOptions, tyro.conf.arg(name="")]
Options = Annotated[FleetOptions, tyro.conf.arg(name="")]


class Numbers:
    """Exact numbers of tiles that a command line states; `bind` gives it a domain's fields."""

    def given(self) -> dict[str, Any]:
        """List those that were stated, by the settings' names."""
        assert dataclasses.is_dataclass(self)
        stated = dataclasses.asdict(self)
        return {name: value for name, value in stated.items() if value not in (None, ())}


def bind(command: Callable, arguments: Sequence[str]) -> Callable:
    """Give a command the options that follow from what its command line chooses.

    A parameter `numbers` gets one for each number of the chosen domain, a parameter `options` one
    for each setting of the chosen planner.

    Args:
        command: a function; one without such parameters is returned as it is.
        arguments: the command line, which names a domain, a run, a planner.

    Raises:
        InputError: what is named is unknown, or the run cannot be read.
    """
    signature = inspect.signature(command)
    hints = get_type_hints(command, include_extras=True)
    defaults: dict[str, Any] = {}
    if "options" in signature.parameters:
        kind: type[RunOptions] = get_type_hints(command)["options"]
        defaults["options"] = kind(planner_settings=stated_planner(arguments, "high"))
    if "numbers" in signature.parameters:
        many = get_type_hints(command)["numbers"] is ManyNumbers
        numbers = _numbers_of(domain_of(arguments), tuple[int, ...] if many else int | None)
        defaults["numbers"], hints["numbers"] = (
            numbers(),
            Annotated[numbers, tyro.conf.arg(name="")],
        )
    if not defaults:
        return command

    @functools.wraps(command)
    def bound(**given: Any) -> Any:
        return command(**given)

    parameters = [
        one.replace(annotation=hints[name], default=defaults.get(name, one.default))
        for name, one in signature.parameters.items()
    ]
    del bound.__wrapped__  # tyro would read the signature there
    bound.__annotations__ = hints
    bound.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    return bound


class ManyNumbers(Numbers):
    """The same, with one number for each of several sizes."""


def domain_of(arguments: Sequence[str]) -> Domain:
    """Find the domain that a command line is about: by name, a run, a layout, or the usual one.

    Raises:
        InputError: the domain is unknown, or the run cannot be read.
    """
    name, rest = take(arguments, "--domain")
    if name is not None:
        return find_domain(name)
    for argument in rest:
        if max(map(len, argument.split("/"))) > LONGEST_NAME:  # a list of numbers, perhaps
            continue
        if argument.startswith(PREFIX) or (Path(argument) / "config.json").exists():
            return make_domain(RunDirectory.open(argument).config.evaluation.domain)
        if Path(argument).is_file():
            with contextlib.suppress(InputError):  # no layout, or one that the command refuses
                return read_plan(argument).domain
    return find_domain(USUAL)


def _numbers_of(domain: Domain, hint: Any) -> type:
    fields = [
        (
            name,
            Annotated[hint, tyro.conf.arg(help=f"exact number of tiles {symbol!r}")],
            dataclasses.field(default=() if hint == tuple[int, ...] else None),
        )
        for name, symbol in domain.counted.items()
    ]
    return dataclasses.make_dataclass("Numbers", fields, bases=(Numbers,), frozen=True)
