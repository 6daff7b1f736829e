"""The settings of priority-based search."""

from dataclasses import dataclass
from typing import Literal, get_args

from qdenv.registry import Entry
from qdenv.types import InputError

MAX_WINDOW = 30  # the timesteps of conflicts are the bits of one word

Rule = Literal["published", "plain"]


@dataclass(frozen=True)
class PbsConfig:
    """Priority-based search, window by window.

    Attributes:
        rule: what becomes of an agent that finds no path past those with precedence over it.
            "published": it stays where it is, against all reservations, and whoever waits at its
            start has precedence there; so plans never fail, and crowds freeze. "plain": the search
            tries another order.
        node_limit: most nodes of the search tree that are expanded per window; a window that is
            still unsolved is driven by PIBT where its best plan has conflicts.
    """

    rule: Rule = "published"
    node_limit: int = 20_000

    def __post_init__(self) -> None:
        """Refuse an unknown rule, and a search without nodes."""
        if self.rule not in get_args(Rule):
            raise InputError(
                f"unknown rule {self.rule!r}: choose one of {', '.join(get_args(Rule))}"
            )
        if self.node_limit < 0:
            raise InputError("priority-based search expands 0 nodes a window, or more")


PBS = Entry(PbsConfig, "qdenv.simulate.mapf.pbs.planner:pbs")
