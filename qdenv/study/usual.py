"""What is taken where nobody says it: robots and timesteps, and the numbers of sizes known."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np

from qdenv.domains.base import Domain
from qdenv.domains.settings import KnownSize

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
    """Choose the numbers that nobody stated, for layouts that are put to the same.

    Args:
        domain: whose layouts.
        layouts: int8 [H, W] each; what their size gives counts where they are all of one size.
        agents: None where nobody says.
        timesteps: likewise.
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
