"""What planning agents see around them, and the sets of cells they can reach, as bits."""

from typing import NamedTuple

import jax

from qdenv.types import Array

REACH = 10  # most cells in sight to each side: the longest window
UNIT = 4  # prices are counted in quarters of a timestep
CODE_BITS = 12  # room for the end of a path: level, layer, row, column
NEVER = 2**30
NOISE_STEP = 0x5851  # times the round: other ties are settled in every round
LONGEST_STAY = 20  # elapsed service is one bit of a word, for a whole window longer


class View(NamedTuple):
    """What K agents see around them: squares of side E = 2 * reach + 1, at most 21.

    Attributes:
        taken: uint32 [window, 5, E, K], reserved cells and moves (`reservation`).
        free: uint32 [E, K], cells without walls.
        goal: uint32 [2, E, K], the current and the next goal, where they end a level.
        goal_row: int32 [2, K], their rows in sight (0 where out of sight).
        goal_column: int32 [2, K], likewise.
        price: int32 [2, E, E, K], quarter steps to go from each cell, per level.
        tail: int32 [K], quarter steps to go once the current goal is done.
        stay: int32 [2, K], timesteps to serve at each goal.
        serving: int32 [K], timesteps still to serve where the agent stands; 0 while driving.
        penalty: int32 [K], quarter steps per layer.
        noise: int32 [K], random bits that settle ties.
    """

    taken: Array
    free: Array
    goal: Array
    goal_row: Array
    goal_column: Array
    price: Array
    tail: Array
    stay: Array
    serving: Array
    penalty: Array
    noise: Array

    @property
    def side(self) -> int:
        """Rows and columns in sight (E)."""
        return self.free.shape[0]

    @property
    def middle(self) -> int:
        """Row and column of the agent itself."""
        return self.free.shape[0] // 2


class Front(NamedTuple):
    """What can be reached at one timestep; the axes are layer, level, row, agent.

    The order matters for speed: whole layers and rows move as blocks, agents lie side by side.

    Attributes:
        cells: uint32 [layers, 2, E, K], reached by driving, goals included.
        served: uint32 [layers, 2, K], bit e: serving for e timesteps.
        opened: uint32 [layers, 2, 1, K], all ones where a path may go on from the current goal:
            in level 1 when service there just ended.
    """

    cells: Array
    served: Array
    opened: Array


def clashes(taken: Array) -> tuple[jax.Array, ...]:
    """Mark where arriving would conflict: by waiting, moving right, left, down, up."""
    cell, right, left, down, up = (taken[plane] for plane in range(5))
    return cell, cell | left, cell | right, cell | up, cell | down
