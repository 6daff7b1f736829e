"""Priority-based search, window by window, against brute force over priorities and ties."""

import functools
from typing import NamedTuple

import numpy as np
import pytest
from pbs_oracle import (
    Agent,
    Instance,
    Maze,
    TooMany,
    check_plan,
    conflict,
    every_choice_works,
    explains,
    orders,
    random_instance,
    some_choice_works,
)

RULES = ("published", "plain")
SOME, EVERY = some_choice_works, every_choice_works
MOST = 3000  # searches of the oracle per instance


@functools.cache
def mazes(count: int) -> list[Maze]:
    """Draw the instances of so many agents."""
    rng = np.random.default_rng(count)
    return [Maze(random_instance(rng, count)) for _ in range(200)]


def can(works, maze: Maze) -> bool | None:
    """Ask whether some order works; None where that would take too long to find out."""
    try:
        return any(works(maze, order, MOST) for order in orders(maze))
    except TooMany:
        return None
