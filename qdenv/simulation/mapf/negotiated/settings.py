"""The negotiated planner's numbers: its settings, the two efforts in use, its limits."""

from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Interval

from qdenv.devices import Backend
from qdenv.ranges import Ranged
from qdenv.types import InputError

MAX_WINDOW = 10  # a square of 2 * 10 + 1 columns around any cell lies within one packed word
# Timesteps served so far are one bit of a 32-bit word, a whole window longer; agents that stay
# longer are planned as if they stayed this long.
MAX_SERVICE = 20
MARGIN = MAX_WINDOW  # so that no agent sees beyond the border
_MAX_CONFLICT_LEVELS = 4  # more would not fit into the code of a path's end

COST_UNIT = 4  # costs are counted in quarters of a timestep
MOVE_UNIT = 64  # where moves have costs: in units of which a move costs 64 on average
# Above what standing still through a window can cost, so that a larger penalty hardly makes a
# difference, also where moves have costs; and those of a path fit beside the code of its end.
_MAX_PENALTY = 1 << 14

_LARGEST = 1_000_000  # of any number: more fits into no count of costs
_Number = Annotated[int, Interval(ge=1, le=_LARGEST)]


@dataclass(frozen=True)
class NegotiatedConfig(Ranged):
    """Settings of the negotiated planner, whose agents bargain over who gives way.

    After PathFinder, McMurchie and Ebeling 1995, https://doi.org/10.1145/201310.201328.
    """

    lookahead: _Number = 10  # timesteps planned without conflict, at most the simulation's window
    lanes: _Number = 4  # agents that plan against the same reservations in one round
    # most rounds, in units of ``agents / lanes``
    rounds: Annotated[float, Interval(gt=0, le=_LARGEST)] = 12.0
    # how many numbers 0, 1, ... of soft conflicts of a path are distinguished, the last of which
    # stands for all larger ones; 1 to 4.
    conflict_levels: Annotated[int, Interval(ge=1, le=_MAX_CONFLICT_LEVELS)] = 4
    # timesteps that an agent would rather lose than drive over one reservation, at its first,
    # second, ... attempt within a window; the last number also holds for all later attempts.
    penalties: tuple[Annotated[float, Interval(ge=0, le=_LARGEST)], ...] = (
        *(0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5),
        *(4.5, 5.5, 6.5, 8.5, 11.0, 16.0),
    )
    # let agents avoid the cells that others took in the last plan, if that costs nothing
    remember: bool = True
    # what agents without a reservation do: follow the joint plan of PIBT, or stand still, which
    # congests more often
    last_resort: Literal["pibt", "wait"] = "pibt"
    # where to run: compiled host code (also "auto") or XLA
    backend: Backend = "auto"

    def __post_init__(self) -> None:
        """Refuse numbers that make no planner."""
        super().__post_init__()
        if not self.penalties:
            raise InputError("a negotiated planner needs penalties: give at least one")

    def planned_ahead(self, window: int, horizon: int) -> int:
        """Return the number of timesteps planned without conflict.

        A plan has `window` timesteps, of which `horizon` are driven.
        """
        return max(horizon, min(self.lookahead, window))

    def penalty_costs(self, has_costs: bool) -> np.ndarray:
        """Return the penalties, int32 [attempts], in the units of a world with or without costs.

        Those are 1/4 of a timestep without, and where a world `has_costs` 1/64 of a move.
        """
        costs = np.array([round(COST_UNIT * penalty) for penalty in self.penalties], np.int32)
        scale = MOVE_UNIT // COST_UNIT if has_costs else 1
        return np.minimum(costs * scale, _MAX_PENALTY)

    def max_rounds(self, agents: Any) -> Any:
        """Return the most rounds (float32) of a number of `agents`, padding not counted.

        Padding agents must not change the number of rounds, and so no result.
        """
        return np.float32(self.rounds) * -(-agents // self.lanes)


# Low for the inside of a search: less time, for some throughput. More lanes than these cost
# throughput on either: their agents plan without one another.
HIGH = NegotiatedConfig()
LOW = NegotiatedConfig(
    lookahead=7, lanes=8, rounds=4.0, conflict_levels=3, penalties=(0.5, 1.5, 2.5, 4.5, 8.0, 16.0)
)
EFFORTS = {"low": LOW, "high": HIGH}
