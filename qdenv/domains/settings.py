"""What the settings of every domain hold, and the numbers of sizes that are known by themselves."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple, Self

import tyro

from qdenv.ranges import Ranged


class KnownSize(NamedTuple):
    """The numbers of a domain at one size, where they do not follow from those of another."""

    steps: int  # steps of growth of an automaton that was trained at another size, C
    timesteps: int  # how long a simulation lasts whose numbers are reported, T
    agents: int = 1  # how many robots drive, N_a; 1 where no fleet does
    numbers: Mapping[str, int] = {}  # exact numbers of tiles, by the settings' names
    about: str = "the paper's evaluation size"  # what kind of size it is, as commands say it


@dataclass(frozen=True)
class DomainConfig(Ranged):
    """What the settings of every domain hold; a domain's own derive from this."""

    rows: int = 33  # rows of the whole layout, frame included
    cols: int = 36  # columns of the whole layout, frame included
    # No option of its own: a drawing comes in a file.
    # rows of a drawing of the whole layout: a tile where a cell must hold it, ``?`` where anything
    # may be; empty where nothing is kept
    keep: tyro.conf.SuppressFixed[tyro.conf.Fixed[tuple[str, ...]]] = field(
        default=(), kw_only=True
    )

    def for_area(self, ratio: float, given: Collection[str]) -> Self:
        """Let further numbers follow the area of the layout; numbers of tiles did already.

        Args:
            ratio: how much larger the generated area is than the one these numbers were for.
            given: names of the settings that stay as they are.
        """
        del ratio, given
        return self

    def for_known(self, size: KnownSize, given: Collection[str]) -> Self:
        """Take further numbers of a size that is known, in place of those that `for_area` gives.

        Args:
            size: what is known of the size of these settings.
            given: names of the settings that stay as they are.
        """
        del size, given
        return self
