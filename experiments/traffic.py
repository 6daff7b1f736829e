"""Saved simulations: tables with a row per run, of some layouts with some numbers of agents."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from experiments.layouts import OfLayout
from experiments.ledger import Case, Outcome, Run, complete, outcomes_of, rate, read_runs
from experiments.pieces import Folders


@dataclass(frozen=True)
class SavedTraffic(OfLayout):
    """Simulations of one layout."""

    kind = "simulations"
    file = "traffic/{0.table}.csv"
    table: str  # the file they stand in, which figures share
    agents: tuple[int, ...]  # numbers of them
    timesteps: int = 5000  # horizon T
    seeds: int = 50  # how many
    planner: str = "high"  # one of `ledger.DRIVERS`

    @property
    def name(self) -> str:
        """Return its name in lists."""
        counts = ",".join(map(str, self.agents))
        return f"{self.seeds} runs of {self.layout.stem}, {counts} agents, {self.planner}"

    def cases(self, folders: Folders) -> list[Case]:
        """List what is simulated: nothing where the layout could not be repaired."""
        if self.layout.refusal(folders):
            return []
        return [self.case_of(folders, count, self.timesteps, self.planner) for count in self.agents]

    def read(self, folders: Folders) -> list[Run]:
        """Read those of its runs that are saved and belong to the layout as it is."""
        if not self.layout.done(folders) or not self.path(folders).exists():
            return []
        wanted = {case.key(seed) for case in self.cases(folders) for seed in range(self.seeds)}
        # One of each: of two processes that share a file both may have made it.
        found = {run.key: run for run in read_runs(self.path(folders)) if run.key in wanted}
        return list(found.values())

    def outcomes(self, folders: Folders) -> list[Outcome]:
        """Condense what is saved, a row per number of agents, few to many."""
        return sorted(outcomes_of(self.read(folders)), key=lambda row: row.agents)

    def done(self, folders: Folders) -> float:
        """Return which share of the runs is saved."""
        if self.layout.refusal(folders):
            return 1.0
        return len(self.read(folders)) / (self.seeds * len(self.agents))

    def seconds(self, folders: Folders) -> float:
        """Estimate the CPU seconds of all runs."""
        each = rate(self.planner, self.read(folders)) * self.timesteps
        return each * sum(self.agents) * self.seeds

    def make(self, folders: Folders) -> None:
        """Simulate what is missing."""
        complete(self.path(folders), self.cases(folders), range(self.seeds), client=folders.client)


def name_layouts(paths: Sequence[Path]) -> dict[str, Path]:
    """Name layout files briefly: by their stem where that is enough, else by their whole path."""
    stems = Counter(path.stem for path in set(paths))
    return {path.stem if stems[path.stem] == 1 else str(path): path for path in paths}


def describe(found: Sequence[Outcome], refusal: str = "") -> tuple[str, str]:
    """Write two cells of a table: the first case's success rate, and what successful runs move.

    Where there is no case they say why.
    """
    if not found:
        return ("N/A", refusal) if refusal else ("not made yet", "")
    row = found[0]
    moved = f"{row.throughput:.3f} ± {row.error:.3f}" if row.successes else "none"
    return f"{row.successes}/{row.runs} ({row.low:.0%} to {row.high:.0%})", moved
