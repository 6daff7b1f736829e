"""Saved simulations: tables with a row per run, of some layouts with some numbers of agents."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from experiments.layouts import SavedLayout
from experiments.pieces import Folders, Piece, Say
from qdenv.study.ledger import Case, Outcome, Run, complete, outcomes_of, read_runs

# CPU seconds of one agent's timestep where no run of the planner is known.
RATES = {"low": 1.3e-6, "high": 2.5e-6, "plain": 6e-6, "published": 5e-6}


@dataclass(frozen=True)
class SavedTraffic(Piece):
    """Simulations of one layout."""

    kind = "simulations"
    table: str  # the file they stand in, which figures share
    layout: SavedLayout  # which
    agents: tuple[int, ...]  # numbers of them
    timesteps: int = 5000  # horizon T
    seeds: int = 50  # how many
    planner: str = "high"  # one of `ledger.DRIVERS`
    stop: bool = True  # runs end where they congest

    @property
    def name(self) -> str:
        """Return its name in lists."""
        counts = ",".join(map(str, self.agents))
        return f"{self.seeds} runs of {self.layout.stem}, {counts} agents, {self.planner}"

    @property
    def needs(self) -> tuple[Piece, ...]:
        """The layout."""
        return (self.layout,)

    def path(self, folders: Folders) -> Path:
        """Find its file."""
        return folders.results / "traffic" / f"{self.table}.csv"

    def cases(self, folders: Folders) -> list[Case]:
        """List what is simulated: nothing where the layout could not be repaired."""
        made = self.layout.read(folders)
        if made.refused:
            return []
        numbers = (self.timesteps, self.planner, self.stop)
        return [
            Case(self.layout.stem, made.layout, made.domain, count, *numbers)
            for count in self.agents
        ]

    def read(self, folders: Folders) -> list[Run]:
        """Read those of its runs that are saved and belong to the layout as it is."""
        if not self.layout.done(folders) or not self.path(folders).exists():
            return []
        wanted = {case.key(seed) for case in self.cases(folders) for seed in range(self.seeds)}
        return [run for run in read_runs(self.path(folders)) if run.key in wanted]

    def outcomes(self, folders: Folders) -> list[Outcome]:
        """Condense what is saved, a row per number of agents, few to many."""
        return sorted(outcomes_of(self.read(folders)), key=lambda row: row.agents)

    def done(self, folders: Folders) -> float:
        """Return which share of the runs is saved."""
        if self.layout.done(folders) and not self.cases(folders):
            return 1.0
        return len(self.read(folders)) / (self.seeds * len(self.agents))

    def cost(self, folders: Folders) -> float:
        """Estimate the CPU seconds of the runs that are missing."""
        if self.done(folders) == 1:
            return 0.0
        known = self.read(folders)
        work = sum(self.agents) * self.seeds - sum(run.agents for run in known)
        return rate(self.planner, known) * work * self.timesteps

    def make(self, folders: Folders, say: Say) -> None:
        """Simulate what is missing."""
        given = self.path(folders), self.cases(folders), range(self.seeds)
        complete(*given, say=say, client=folders.client)


def rate(planner: str, known: Sequence[Run]) -> float:
    """Estimate the CPU seconds of one agent's timestep, from known runs where there are some."""
    if not known:
        return RATES[planner]
    work = sum(run.agents * run.timesteps for run in known)
    return sum(run.cpu_seconds for run in known) / work


def rate_of(row: Outcome) -> str:
    """Write a success rate with its Wilson interval, as tables do."""
    return f"{row.successes}/{row.runs} ({row.low:.0%} to {row.high:.0%})"


def moved_in(row: Outcome) -> str:
    """Write the throughput of successful runs with its standard error, as tables do."""
    return f"{row.throughput:.3f} +- {row.error:.3f}" if row.successes else "none"
