"""What users say of a study in words: seeds, numbers of agents, who plans."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, TypeAlias, TypedDict

import numpy as np

from qdenv.domains.base import Domain, KnownSize
from qdenv.ranges import LARGEST_SEED
from qdenv.simulate.mapf.goals import check_playable
from qdenv.simulate.mapf.settings import FleetConfig, find_planner
from qdenv.surrogate.settings import PUBLISHED, SurrogateConfig
from qdenv.types import InputError, TaskRule, look_up

_SURROGATES = {"small": SurrogateConfig(), "published": PUBLISHED}
_MOST_SEEDS = 100_000
_MOST_COUNTS = 1000  # numbers of agents in one study
_SIMULATING = "simulating"  # what a study reports to do
# (what is done, its share of 0 to 1 or a negative number where that is unknown, a note)
Progress: TypeAlias = Callable[[str, float, str], None]


def silent(doing: str, share: float, note: str) -> None:
    """Report no progress."""


def parse_seeds(seeds: int | str | Sequence[int | str]) -> tuple[int, ...]:
    """Read seeds: a count, which gives the first ones, or a list.

    Args:
        seeds: 10 or "10" for ten seeds from 0 on; "3,5,9" for these three, "7," for this one. In
            a sequence one entry is read the same way, several are a list: (10,), ("3,5",),
            (3, 5, 9).

    Raises:
        InputError: it is neither, or there is no seed in it.
    """
    parts = [seeds] if isinstance(seeds, int | str) else list(seeds)
    text = str(parts[0]) if len(parts) == 1 else ",".join(map(str, parts))
    try:
        numbers = [int(part) for part in text.split(",") if part.strip()]
    except ValueError:
        numbers = []
    if not numbers or min(numbers) < 0 or max(numbers) > LARGEST_SEED:
        raise InputError(f"seeds {text!r}: write 10 for ten seeds, 3,5,9 for these, 7, for one")
    if len(set(numbers)) < len(numbers):
        raise InputError(f"seeds {text!r} names a seed twice, which tells nothing new")
    if "," in text:
        return tuple(numbers)
    if not 1 <= numbers[0] <= _MOST_SEEDS:
        raise InputError(f"seeds {text!r}: simulate at least one seed, and at most {_MOST_SEEDS:,}")
    return tuple(range(numbers[0]))


def parse_counts(text: str) -> tuple[int, ...]:
    """Read numbers of agents: one ("200"), a list ("50,100") or a range ("50:400:50").

    The end of a range belongs to it.

    Raises:
        InputError: none of the three, a count below one or named twice, or too many of them.
    """
    counts: Sequence[int]
    try:
        if ":" in text:
            first, last, *step = (int(part) for part in text.split(":"))
            counts = range(first, last + 1, *step)[: _MOST_COUNTS + 1]
        else:
            counts = [int(part) for part in text.split(",")]
    except (ValueError, TypeError):
        raise InputError(f"agents {text!r}: write 200, or 50,100, or 50:400:50") from None
    if not counts or min(counts) < 1:
        raise InputError(f"agents {text!r} holds no number of agents above zero")
    if len(counts) > _MOST_COUNTS:
        raise InputError(
            f"agents {text!r} are more than {_MOST_COUNTS} numbers: choose a larger step, as in "
            "50:400:50"
        )
    if len(set(counts)) < len(counts):
        raise InputError(f"agents {text!r} names a number twice: name each once")
    return tuple(counts)


def _scale_counts(text: str, factor: float) -> str:
    """Multiply the numbers in words of `parse_counts`, so that a range keeps its steps."""
    return re.sub(r"\d+", lambda number: str(round(int(number[0]) * factor)), text)


class Driving(TypedDict, total=False):
    """Who plans, and until when."""

    effort: str  # "low" for a quick look, "high" for numbers to report; of the negotiated planner
    planner: Any  # name of a registered planner, or settings like ``PbsConfig(rule="plain")``
    stop: bool  # end a run at its first congested window, as published; else it goes on


def make_fleet(
    agents: int,
    timesteps: int,
    effort: str | None = None,
    planner: Any = "",
    stop: bool = True,
) -> FleetConfig:
    """Make the numbers of a simulation from words.

    Args:
        agents: how many take part.
        timesteps: horizon T.
        effort: see `Driving`, as the others.
        planner: the negotiated one with high effort unless given.
        stop: at the first congested window.

    Raises:
        InputError: a word is unknown, or the numbers make no simulation.
    """
    settings = find_planner(effort, planner)
    return FleetConfig(agents, timesteps, planner=settings, stop_when_congested=stop)


def find_surrogate(size: str, numbers: Mapping[str, Any]) -> SurrogateConfig:
    """Choose a surrogate's settings by words.

    Args:
        size: "small" or "published".
        numbers: in place of those of this size, by the settings' names; None stands for nothing.

    Raises:
        InputError: a word is unknown, or a number learns nothing.
    """
    stated = {name: value for name, value in numbers.items() if value is not None}
    chosen: SurrogateConfig = look_up(_SURROGATES, size, "size")
    for name in stated:
        look_up(vars(chosen), name, "setting")
    return replace(chosen, **stated)


def fleet_tasks(layout: np.ndarray, tasks: TaskRule | None, agents: int) -> TaskRule:
    """Refuse what no simulation can begin with; returns what the agents do.

    Raises:
        InputError: no fleet drives in this domain, or that many do not fit the layout.
    """
    if tasks is None:
        raise InputError("no fleet drives in this domain: there is no traffic to simulate")
    check_playable(layout, tasks, agents)
    return tasks


AGENTS, TIMESTEPS = 200, 1000


class Usual(NamedTuple):
    """The numbers of a simulation."""

    agents: int  # how many robots drive
    timesteps: int  # how long, T
    said: str  # a line about those that a known size gives; "" where it gives none


def usual_fleet(
    domain: Domain,
    layouts: Sequence[np.ndarray],
    agents: int | None = None,
    timesteps: int | None = None,
) -> Usual:
    """Choose the numbers that are not stated, the same for all layouts.

    Args:
        domain: whose layouts.
        layouts: int8 [H, W] each; what their size gives counts where they are all of one size.
        agents: None if not stated.
        timesteps: None if not stated.
    """
    shapes = {layout.shape for layout in layouts}
    size = domain.known_size(*shapes.pop()) if len(shapes) == 1 else None
    numbers = (size.agents, size.timesteps) if size else (AGENTS, TIMESTEPS)
    taken = {
        name: value
        for name, value, stated in (
            ("agents", numbers[0], agents),
            ("timesteps", numbers[1], timesteps),
        )
        if stated is None and size
    }
    return Usual(
        numbers[0] if agents is None else agents,
        numbers[1] if timesteps is None else timesteps,
        _in_words(layouts[0].shape, size, taken) if size else "",
    )


def describe_growth(domain: Domain, shape: tuple[int, int], given: Collection[str]) -> str:
    """Say which numbers a known size gives to a layout that is drawn for it; "" for none.

    Args:
        domain: at the size that the layout is made from.
        shape: rows and columns of the layout.
        given: names of what was stated, "steps" among them where nothing grows.
    """
    size = domain.known_size(*shape)
    if size is None:
        return ""
    numbers = {**size.numbers, "steps": size.steps}
    taken = {name: value for name, value in numbers.items() if name not in given}
    return _in_words(shape, size, taken).replace(" steps", " steps of growth")


def _in_words(shape: tuple[int, ...], size: KnownSize, taken: dict[str, int]) -> str:
    if not taken:
        return ""
    said = ", ".join(f"{value} {name}" for name, value in taken.items())
    return f"{shape[0]} x {shape[1]} is {size.about}: {said} unless stated"
