"""The settings of a repair."""

from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Interval

from qdenv.ranges import NonNegativeFloat, NonNegativeInt, Ranged

Polish = Literal["none", "quick", "full"]
# Annealing moves per free cell. In the time of "quick" windows saved less than more annealing did,
# on layouts of a search most clearly: so only "full" uses the solver.
MOVES_PER_CELL = {"none": 400, "quick": 1400, "full": 2500}
_MIN_MOVES = 20_000  # a few milliseconds, which tiny layouts need as well


@dataclass(frozen=True)
class RepairConfig(Ranged):
    """Limits of one repair; all but `time_limit` are deterministic."""

    # "none" anneals as little as is safe, "quick" as long as a search can afford, "full" longer;
    # then the solver improves windows (but for rules on aisles and racks), bounds the whole layout
    # up to 20,000 free cells, and up to 10,000, if that bound is near the cost, branches on it
    polish: Polish = "quick"
    # annealing moves per free cell; None for the number that `polish` implies
    moves_per_cell: NonNegativeInt | None = None
    gap: NonNegativeFloat = 0.0  # relative gap at which the solver stops
    # branch-and-bound nodes of one solve; None for 1000
    node_limit: NonNegativeInt | None = None
    # wall-clock limit of one solve in seconds, a safety net; only a repair that reaches it is not
    # reproducible, and its status says so unless it is proven optimal
    time_limit: Annotated[float, Interval(gt=0)] = 1800.0
    # threads that repair layouts of a batch; None for one per core
    workers: NonNegativeInt | None = None

    def count_moves(self, cells: int) -> int:
        """Return the number of annealing moves for a number of free cells."""
        per_cell = self.moves_per_cell
        per_cell = MOVES_PER_CELL[self.polish] if per_cell is None else per_cell
        return max(cells * per_cell, _MIN_MOVES)
