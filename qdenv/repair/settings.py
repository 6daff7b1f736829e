"""The settings of a repair: what a user may choose, and the numbers behind each named effort."""

from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

from annotated_types import Interval

from qdenv.ranges import NonNegativeFloat, NonNegativeInt, Ranged
from qdenv.types import InputError

Polish = Literal["none", "quick", "full"]


class MilpLimits(NamedTuple):
    """When the solver works on a whole layout, and how long; deterministic."""

    node_limit: int  # branch-and-bound nodes of one solve
    # offers to interrupt a solve, one per round of its work, after which it ends
    interrupt_budget: int
    rounds: int  # solves, each with more connectivity cuts
    max_gap_to_branch: float  # relative gap of the relaxation beyond which branching would not pay
    max_cells: int  # free cells beyond which nothing is bounded: the relaxation alone takes minutes


class WindowLimits(NamedTuple):
    """How long windows of a layout are solved, one after the other; deterministic."""

    side: int  # cells a side of one window
    windows: int  # how many are tried in vain on a layout of a thousand cells; more on larger ones
    reward: float  # how many more are tried for each unit of cost that one has saved
    node_limit: int  # branch-and-bound nodes of one window


class Effort(NamedTuple):
    """What a named polish means."""

    moves_per_cell: int  # annealing moves per free cell
    # limits of the solver on windows; None where it solves none
    windows: WindowLimits | None = None
    # limits of the solver on the whole layout; None where it does not work on it
    milp: MilpLimits | None = None


# Windows saved less than more annealing did in the same time, on layouts of a search most clearly.
EFFORTS = {
    "none": Effort(400),
    "quick": Effort(1400),
    "full": Effort(
        2500,
        WindowLimits(side=8, windows=6, reward=6.0, node_limit=1),
        MilpLimits(
            node_limit=1000,
            interrupt_budget=100,
            rounds=4,
            max_gap_to_branch=0.08,
            max_cells=20_000,
        ),
    ),
}
_MIN_MOVES = 20_000  # a few milliseconds, which tiny layouts need as well


@dataclass(frozen=True)
class RepairConfig(Ranged):
    """Limits of one repair; all but `time_limit` are deterministic."""

    # "none" anneals as little as is safe, "quick" as long as a search can afford, "full" longer;
    # then the solver improves windows, and runs on the whole layout to a proof or to its limits
    polish: Polish = "quick"
    # annealing moves per free cell; None for what `polish` means
    moves_per_cell: NonNegativeInt | None = None
    gap: NonNegativeFloat = 0.0  # relative gap at which the solver stops
    # branch-and-bound nodes of one solve; None for what `polish` means
    node_limit: NonNegativeInt | None = None
    # wall-clock safety net of one solve in seconds; only when it fires is a repair not
    # reproducible, and its status says so
    time_limit: Annotated[float, Interval(gt=0)] = 1800.0
    # threads that repair layouts of a batch; None for one per core
    workers: NonNegativeInt | None = None

    def __post_init__(self) -> None:
        """Refuse an unknown polish."""
        super().__post_init__()
        if self.polish not in EFFORTS:
            raise InputError(f"polish {self.polish!r} must be one of {', '.join(EFFORTS)}")

    @property
    def effort(self) -> Effort:
        """The numbers behind `polish`, with what the user chose in their place."""
        effort = EFFORTS[self.polish]
        if self.moves_per_cell is not None:
            effort = effort._replace(moves_per_cell=self.moves_per_cell)
        if self.node_limit is not None and effort.milp is not None:
            effort = effort._replace(milp=effort.milp._replace(node_limit=self.node_limit))
        return effort

    def count_moves(self, cells: int) -> int:
        """Return the number of annealing moves for a number of free cells."""
        return max(cells * self.effort.moves_per_cell, _MIN_MOVES)
