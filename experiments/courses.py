"""Saved courses: tasks finished over time and where agents were, added up over runs."""

import json
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import NamedTuple

import numpy as np

from experiments.layouts import SavedLayout
from experiments.pieces import Folders, Piece, Say
from experiments.traffic import RATES
from qdenv.io.files import write_json
from qdenv.stats import Sample, margin
from qdenv.study.ledger import Case

BIN = 50  # timesteps that are counted together
CHUNK = 10  # runs from one saving to the next
PARTS = 1_000_000  # of all agents' time: what the file counts it in


class Course(NamedTuple):
    """What several runs did; sums, so that further runs can be added."""

    runs: int  # how many, of seeds 0, 1, 2, ..
    congested: int  # how many of them congested
    cpu_seconds: float  # of all of them
    tasks: np.ndarray  # int [bins], finished in `BIN` timesteps, summed over the runs
    squares: np.ndarray  # int [bins], the squares of these counts, summed
    usage: np.ndarray  # float [H, W], share of all agents' time spent on each cell, summed

    @property
    def rates(self) -> tuple[np.ndarray, np.ndarray]:
        """Tasks per timestep in each bin: mean over the runs, half its 95 % interval (or NaN)."""
        mean = self.tasks / self.runs
        spread = np.maximum(self.squares - self.runs * mean**2, 0.0) / max(self.runs - 1, 1)
        errors = np.sqrt(spread / self.runs)
        half = [margin(Sample(*one, self.runs)) for one in zip(mean, errors, strict=True)]
        return mean / BIN, np.array(half) / BIN

    @property
    def ends(self) -> np.ndarray:
        """Timesteps at which the bins end, int [bins]."""
        return BIN * np.arange(1, len(self.tasks) + 1)


@dataclass(frozen=True)
class SavedCourse(Piece):
    """Runs of one layout with one number of agents."""

    kind = "courses"
    layout: SavedLayout  # which
    agents: int = 200  # how many
    timesteps: int = 5000  # horizon T, a multiple of `BIN`
    seeds: int = 100  # how many
    stop: bool = False  # runs end where they congest
    planner: str = "high"  # one of `ledger.DRIVERS`

    @property
    def name(self) -> str:
        """Return its name in lists."""
        return f"course of {self.seeds} runs of {self.layout.stem}, {self.agents} agents"

    @property
    def needs(self) -> tuple[Piece, ...]:
        """The layout."""
        return (self.layout,)

    def path(self, folders: Folders) -> Path:
        """Find its file."""
        return folders.results / "courses" / f"{self.layout.stem}-{self.agents}.json"

    def case(self, folders: Folders) -> Case:
        """Return what is simulated."""
        made = self.layout.read(folders)
        numbers = (self.agents, self.timesteps, self.planner, self.stop)
        return Case(self.layout.stem, made.layout, made.domain, *numbers)

    def read(self, folders: Folders) -> Course | None:
        """Read what is saved; None for nothing, or runs of another layout or other settings."""
        if not (self.path(folders).exists() and self.layout.done(folders)):
            return None
        content = json.loads(self.path(folders).read_text())
        if content["of"] != list(self.case(folders).key(0)[:-1]):
            return None
        usage = np.array([[int(part) for part in row.split()] for row in content["usage"]])
        return Course(
            runs=content["runs"],
            congested=content["congested"],
            cpu_seconds=content["cpu_seconds"],
            tasks=np.array(content["tasks"]),
            squares=np.array(content["squares"]),
            usage=usage * content["runs"] / PARTS,
        )

    def done(self, folders: Folders) -> float:
        """Return which share of the runs is saved."""
        if self.layout.done(folders) and self.layout.read(folders).refused:
            return 1.0
        found = self.read(folders)
        return min(found.runs / self.seeds, 1.0) if found else 0.0

    def cost(self, folders: Folders) -> float:
        """Estimate the CPU seconds of the runs that are missing."""
        found = self.read(folders)
        known = found.cpu_seconds / found.runs if found else None
        each = RATES[self.planner] * self.agents * self.timesteps if known is None else known
        return each * self.seeds * (1 - self.done(folders))

    def make(self, folders: Folders, say: Say) -> None:
        """Simulate what is missing, and save it every few runs."""
        case, found = self.case(folders), self.read(folders)
        while found is None or found.runs < self.seeds:
            begin = found.runs if found else 0
            more = simulate(case, range(begin, min(begin + CHUNK, self.seeds)))
            found = more if found is None else add(found, more)
            self._write(folders, case, found)
            left = timedelta(seconds=round(self.cost(folders)))
            say(f"{found.runs} of {self.seeds} runs, about {left} left: {self.layout.stem}")

    def _write(self, folders: Folders, case: Case, course: Course) -> None:
        parts = np.rint(course.usage / course.runs * PARTS).astype(int)
        content = course._asdict() | {
            "cpu_seconds": round(course.cpu_seconds, 3),
            "tasks": course.tasks.tolist(),
            "squares": course.squares.tolist(),
            "usage": [" ".join(map(str, row)) for row in parts],
        }
        write_json(self.path(folders), {"of": case.key(0)[:-1]} | content)


def add(some: Course, more: Course) -> Course:
    """Add further runs."""
    return Course(
        runs=some.runs + more.runs,
        congested=some.congested + more.congested,
        cpu_seconds=some.cpu_seconds + more.cpu_seconds,
        tasks=some.tasks + more.tasks,
        squares=some.squares + more.squares,
        usage=some.usage + more.usage,
    )


def simulate(case: Case, seeds: range) -> Course:
    """Simulate some runs on one core and add up what they did."""
    from qdenv.study.engine import run_seeds  # imports the simulator

    done = run_seeds(case.tiles, case.domain.simulator.tasks, case.fleet, list(seeds), threads=1)
    finished = np.stack([run.finished for run in done.runs]).astype(int)
    counts = finished.reshape(len(seeds), -1, BIN).sum(axis=2)
    return Course(
        runs=len(seeds),
        congested=sum(bool(run.congested) for run in done.runs),
        cpu_seconds=done.cpu_seconds,
        tasks=counts.sum(axis=0),
        squares=(counts**2).sum(axis=0),
        usage=np.sum([run.usage for run in done.runs], axis=0, dtype=float),
    )
