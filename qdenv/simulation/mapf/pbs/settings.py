"""The settings of priority-based search."""

from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Interval

from qdenv.ranges import Ranged

MAX_WINDOW = 30  # the timesteps of conflicts are the bits of one word
_MOST_NODES = 1_000_000

Rule = Literal["published", "plain"]


@dataclass(frozen=True)
class PbsConfig(Ranged):
    """Priority-based search, window by window.

    Ma et al. 2019, https://arxiv.org/abs/1812.06356; windows of Li et al. 2021,
    https://arxiv.org/abs/2005.07371.
    """

    # what an agent does that finds no path past those with precedence over it. "published": it
    # stays even if others reserved its cell, and agents that wait at their start take precedence
    # there; so plans never fail, and crowds freeze. "plain": the search tries another order.
    rule: Rule = "published"
    # most nodes of the search tree that are expanded per window, in units of the number of agents;
    # a window that is still unsolved is driven by PIBT where its best plan has conflicts
    nodes_per_agent: Annotated[float, Interval(ge=0, le=_MOST_NODES)] = 5.0
