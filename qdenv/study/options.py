"""Options of studies: seeds, numbers of agents, surrogates, and what a known size gives."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from qdenv.domains.base import Domain, KnownSize
from qdenv.ranges import LARGEST_SEED
from qdenv.simulation.mapf.goals import check_playable
from qdenv.surrogates.settings import PUBLISHED, SurrogateConfig
from qdenv.types import InputError, TaskRule, look_up

AGENTS, TIMESTEPS = 200, 1000  # of a simulation on a layout of no known size
_SURROGATES = {"small": SurrogateConfig(), "published": PUBLISHED}
_MOST_SEEDS = 100_000
_MOST_COUNTS = 1000  # numbers of agents in one study


def parse_seeds(seeds: int | str | Sequence[int]) -> tuple[int, ...]:
    """Read seeds: 10 or "10" for ten seeds from 0 on; (3, 5) or "3,5" for these, (7,) or "7,".

    Raises InputError if there is no seed, one is named twice, or one is out of range.
    """
    # A comma makes it a list: "7," is the seed 7, "7" are seven seeds.
    text = str(seeds) if isinstance(seeds, int | str) else "".join(f"{one}," for one in seeds)
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
    """Read numbers of agents: "200", "50,100", or "50:400:50", a range with its end.

    Raises InputError if it is none of the three, a count is below one or named twice, or there are
    too many.
    """
    counts: Sequence[int]
    try:
        if ":" in text:
            first, last, *step = (int(part) for part in text.split(":"))
            # Cut before it is listed: 1:99999999999 must be refused at once.
            counts = range(first, last + 1, *step)[: _MOST_COUNTS + 1]
        else:
            counts = [int(part) for part in text.split(",")]
    except (ValueError, TypeError):
        raise InputError(f"agents {text!r}: write 200, or 50,100, or 50:400:50") from None
    if not counts or min(counts) < 1:
        raise InputError(f"agents {text!r}: give at least one number, all of them above zero")
    if len(counts) > _MOST_COUNTS:
        raise InputError(
            f"agents {text!r} are more than {_MOST_COUNTS} numbers: choose a larger step, as in "
            "50:400:50"
        )
    if len(set(counts)) < len(counts):
        raise InputError(f"agents {text!r} names a number twice: name each once")
    return tuple(counts)


def find_surrogate(size: str, numbers: Mapping[str, Any]) -> SurrogateConfig:
    """Return the settings of a surrogate: "small" or "published", with changes that are not None.

    Raises InputError if a name is unknown, or a number is impossible.
    """
    changes = {name: value for name, value in numbers.items() if value is not None}
    chosen: SurrogateConfig = look_up(_SURROGATES, size, "size")
    for name in changes:
        look_up(vars(chosen), name, "setting")
    return replace(chosen, **changes)


def fleet_tasks(layout: np.ndarray, tasks: TaskRule | None, agents: int) -> TaskRule:
    """Return what the agents do, if a simulation can begin.

    Raises InputError if no fleet drives in this domain, or that many do not fit the layout.
    """
    if tasks is None:
        raise InputError("no fleet drives in this domain: there is no traffic to simulate")
    check_playable(layout, tasks, agents)
    return tasks


def usual_fleet(
    domain: Domain,
    layouts: Sequence[np.ndarray],
    agents: int | None = None,
    timesteps: int | None = None,
) -> tuple[int, int, str]:
    """Return agents, timesteps, and a line about what the layouts' size gives of them, or "".

    A number that is None is that of the size where all layouts have one known size, else `AGENTS`
    or `TIMESTEPS`.
    """
    shapes = {layout.shape for layout in layouts}
    size = domain.known_size(*shapes.pop()) if len(shapes) == 1 else None
    usual = (AGENTS, TIMESTEPS) if size is None else (size.agents, size.timesteps)
    taken: dict[str, int] = {}
    if agents is None:
        agents = taken["agents"] = usual[0]
    if timesteps is None:
        timesteps = taken["timesteps"] = usual[1]
    note = "" if size is None else _describe_size(layouts[0].shape, size, taken)
    return agents, timesteps, note


def describe_growth(domain: Domain, shape: tuple[int, int], given: Collection[str]) -> str:
    """Describe which numbers a known size gives to a layout that is drawn for it; "" for none.

    `domain` is at the size that the layout is made from; `given` holds the names of the numbers
    that were stated, "steps" among them where nothing grows.
    """
    size = domain.known_size(*shape)
    if size is None:
        return ""
    numbers = {**size.numbers, "steps": size.steps}
    taken = {name: value for name, value in numbers.items() if name not in given}
    return _describe_size(shape, size, taken).replace(" steps", " steps of growth")


def _describe_size(shape: tuple[int, ...], size: KnownSize, taken: dict[str, int]) -> str:
    if not taken:
        return ""
    numbers = ", ".join(f"{value} {name}" for name, value in taken.items())
    return f"{shape[0]} x {shape[1]} is {size.about}: {numbers} unless stated"
