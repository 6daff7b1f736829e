"""The settings of a repair: what a user may choose, and the numbers behind each named effort."""

from dataclasses import dataclass
from typing import NamedTuple

from qdenv.types import InputError


class MilpLimits(NamedTuple):
    """When the solver branches, and how long; deterministic.

    Attributes:
        node_limit: branch-and-bound nodes of one solve.
        interrupt_budget: times the solver may ask whether to go on, which it does once per round
            of its work.
        rounds: solves, each with more connectivity cuts.
        max_gap_to_branch: relative gap of the relaxation beyond which branching would not pay.
        max_cells_to_branch: free cells beyond which one round of work takes seconds; there the
            annealer makes twice as many moves instead. None for any number.
    """

    node_limit: int
    interrupt_budget: int
    rounds: int
    max_gap_to_branch: float
    max_cells_to_branch: int | None


class Effort(NamedTuple):
    """What a named polish means.

    Attributes:
        moves_per_cell: annealing moves per free cell.
        milp: limits of the solver; None where it is not asked.
    """

    moves_per_cell: int
    milp: MilpLimits | None


NONE = Effort(800, None)
QUICK = Effort(
    600,
    MilpLimits(
        node_limit=1,
        interrupt_budget=6,
        rounds=2,
        max_gap_to_branch=0.03,
        max_cells_to_branch=3000,
    ),
)
FULL = Effort(
    2500,
    MilpLimits(
        node_limit=1000,
        interrupt_budget=100,
        rounds=4,
        max_gap_to_branch=0.08,
        max_cells_to_branch=None,
    ),
)
EFFORTS = {"none": NONE, "quick": QUICK, "full": FULL}
MIN_MOVES = 20_000  # a few milliseconds, which tiny layouts need as well


@dataclass(frozen=True)
class RepairConfig:
    """Limits of one repair; all but `time_limit` are deterministic.

    Attributes:
        polish: "none" anneals only, "quick" adds a short solver run where it pays, "full" anneals
            longer and lets the solver run to a proof or to its limits.
        moves_per_cell: annealing moves per free cell; None for what `polish` means.
        gap: relative gap at which the solver stops.
        node_limit: branch-and-bound nodes of one solve; None for what `polish` means.
        time_limit: wall-clock safety net of one solve in seconds; only when it fires is a repair
            not reproducible, and its status says so.
        workers: threads that repair layouts of a batch; None for one per core.
    """

    polish: str = "quick"
    moves_per_cell: int | None = None
    gap: float = 0.0
    node_limit: int | None = None
    time_limit: float = 1800.0
    workers: int | None = None

    def __post_init__(self) -> None:
        """Reject a polish that does not exist and numbers that count nothing."""
        if self.polish not in EFFORTS:
            raise InputError(f"polish {self.polish!r} must be one of {', '.join(EFFORTS)}")
        for name in ("moves_per_cell", "node_limit", "workers"):
            value = getattr(self, name)
            # Runs saved by the first version say 0 where nothing was chosen.
            if value == 0:
                object.__setattr__(self, name, None)
            elif value is not None and not (isinstance(value, int) and value > 0):
                raise InputError(f"{name} {value!r} must be a positive whole number, or left out")

    @property
    def effort(self) -> Effort:
        """The numbers behind `polish`, with what the user chose in their place."""
        effort = EFFORTS[self.polish]
        if self.moves_per_cell is not None:
            effort = effort._replace(moves_per_cell=self.moves_per_cell)
        if self.node_limit is not None and effort.milp is not None:
            effort = effort._replace(milp=effort.milp._replace(node_limit=self.node_limit))
        return effort

    def branches_on(self, cells: int) -> bool:
        """Whether the solver may branch on layouts of so many free cells."""
        milp = self.effort.milp
        if milp is None:
            return False
        return milp.max_cells_to_branch is None or cells <= milp.max_cells_to_branch

    def count_moves(self, cells: int) -> int:
        """Count the annealing moves for layouts of so many free cells."""
        effort = self.effort
        # Where the solver is asked but may not branch, the annealer gets its time, unless the user
        # chose how long it runs.
        instead = effort.milp is not None and not self.branches_on(cells)
        twice = 2 if instead and self.moves_per_cell is None else 1
        return max(cells * effort.moves_per_cell * twice, MIN_MOVES)
