"""Saved courses: tasks finished over time and where agents were, added up over runs."""

import json
from dataclasses import dataclass
from datetime import timedelta
from operator import add
from typing import NamedTuple

import numpy as np

from experiments.layouts import OfLayout
from experiments.ledger import RATES, Case
from experiments.pieces import Folders, say
from qdenv.io.files import write_json
from qdenv.stats import Sample, margin
from qdenv.study.engine import run_seeds

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


@dataclass(frozen=True)
class SavedCourse(OfLayout):
    """Runs of one layout with one number of agents."""

    kind = "courses"
    label = "course of {0.seeds} runs of {0.layout.stem}, {0.agents} agents{0.ending}"
    file = "courses/{0.layout.stem}-{0.agents}{0.ending}.json"
    agents: int = 200  # how many
    timesteps: int = 5000  # horizon T, a multiple of `BIN`
    seeds: int = 100  # how many
    stop: bool = False  # runs end where they congest
    planner: str = "high"  # one of `ledger.DRIVERS`

    @property
    def ending(self) -> str:
        """What names of another planner than ours end in."""
        return "" if self.planner == "high" else f"-{self.planner}"

    def case(self, folders: Folders) -> Case:
        """Return what is simulated."""
        return self.case_of(folders, self.agents, self.timesteps, self.planner, self.stop)

    def read(self, folders: Folders) -> Course | None:
        """Read what is saved; None for nothing, or runs of another layout or other settings."""
        if not (self.path(folders).exists() and self.layout.done(folders)):
            return None
        content = json.loads(self.path(folders).read_text())
        if content.pop("of") != list(self.case(folders).key(0)[:-1]):
            return None
        usage = np.array([[int(part) for part in row.split()] for row in content["usage"]])
        sums = {name: np.array(content[name]) for name in ("tasks", "squares")}
        return Course(**content | sums | {"usage": usage * content["runs"] / PARTS})

    def done(self, folders: Folders) -> float:
        """Return which share of the runs is saved."""
        if self.layout.refusal(folders):
            return 1.0
        found = self.read(folders)
        return min(found.runs / self.seeds, 1.0) if found else 0.0

    def seconds(self, folders: Folders) -> float:
        """Estimate the CPU seconds of all runs."""
        found = self.read(folders)
        usual = RATES[self.planner] * self.agents * self.timesteps
        return self.seeds * (found.cpu_seconds / found.runs if found else usual)

    def make(self, folders: Folders) -> None:
        """Simulate what is missing, and save it every few runs."""
        case, found = self.case(folders), self.read(folders)
        while found is None or found.runs < self.seeds:
            begin = found.runs if found else 0
            more = simulate(case, range(begin, min(begin + CHUNK, self.seeds)))
            found = Course(*map(add, found, more)) if found else more
            parts = np.rint(found.usage / found.runs * PARTS).astype(int)
            content = found._asdict() | {
                "cpu_seconds": round(found.cpu_seconds, 3),
                "tasks": found.tasks.tolist(),
                "squares": found.squares.tolist(),
                "usage": [" ".join(map(str, row)) for row in parts],
            }
            write_json(self.path(folders), {"of": case.key(0)[:-1]} | content)
            left = timedelta(seconds=round(self.cost(folders)))
            say(f"{found.runs} of {self.seeds} runs, about {left} left: {self.layout.stem}")


def simulate(case: Case, seeds: range) -> Course:
    """Simulate some runs on one core and add up what they did."""
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
