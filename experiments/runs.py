"""Saved runs: configuration, manifest, metrics, a summary of the archive, and its best elites."""

import csv
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import qdenv
from experiments.pieces import Folders, Piece, say
from qdenv import interrupt
from qdenv.io.arrays import write_arrays
from qdenv.io.files import write_csv
from qdenv.ops.costs import cpu_seconds
from qdenv.run.config import RunConfig, override
from qdenv.run.directory import Metrics, RunDirectory
from qdenv.run.executors import Execution
from qdenv.run.loop import resume, train
from qdenv.types import Measure
from qdenv.view.archive import scatter_objectives

FILES = ("config.json", "manifest.json", "metrics.csv")
SUMMARY, ARCHIVE = "elites.csv", "archive.npz"
BEST = 50  # elites that are kept with their weights: the folder is a run of these


class Summary(NamedTuple):
    """What is kept of a run."""

    config: RunConfig  # every setting
    measures: tuple[Measure, ...]  # the axes of its archive
    metrics: list[Metrics]  # one row per iteration
    # a column per number of the archive, by name: ``cell`` (row-major index), ``objective``, each
    # measure by its name, and means over the simulations
    elites: dict[str, np.ndarray]

    @property
    def last(self) -> Metrics:
        """The final metrics."""
        return self.metrics[-1]

    @property
    def objectives(self) -> np.ndarray:
        """The objectives of all cells, float [C], NaN where empty."""
        columns = {"index": self.elites["cell"].astype(int), "objective": self.elites["objective"]}
        return scatter_objectives(columns, self.measures)


@dataclass(frozen=True)
class SavedRun(Piece):
    """A search, named after its preset and seed."""

    kind = "searches"
    label = "run {0.folder}"
    file = "runs/{0.folder}"
    preset: str  # whose settings
    seed: int = 0  # of the search
    evaluations: int | None = None  # as many as the preset has unless given
    row: str = ""  # how tables call it; the preset unless given
    settings: tuple[tuple[str, Any], ...] = ()  # that differ from the preset's, by name

    @property
    def folder(self) -> str:
        """Name of its folder."""
        return (self.row or self.preset) + (f"-seed{self.seed}" if self.seed else "")

    @property
    def config(self) -> RunConfig:
        """What is run."""
        base = qdenv.find_preset(self.preset)
        # Further seeds are compared to the recorded runs, those of fleets with these settings.
        domain, generator = base.evaluation.domain, base.evaluation.generator
        if domain.fleet and hasattr(generator, "arithmetic"):
            base = override(base, {"arithmetic": "float"})
        if hasattr(domain, "goal_odds"):
            base = override(base, {"goal_odds": "stations"})
        base = override(base, dict(self.settings))
        return replace(base, seed=self.seed, evaluations=self.evaluations or base.evaluations)

    def done(self, folders: Folders) -> float:
        """Return which share of its evaluations is summarised."""
        found = self.read(folders)
        return min(found.last.evaluations / self.config.evaluations, 1.0) if found else 0.0

    def cost(self, folders: Folders) -> float:
        """Estimate the CPU seconds of the evaluations that no folder holds yet."""
        if self.done(folders) == 1:
            return 0.0
        path, made = folders.runs / self.folder, 0
        if (path / "config.json").exists():
            rows = RunDirectory.open(path).read_metrics(salvage=True)
            made = rows[-1].evaluations if rows else 0
        # Of the small surrogate's costs only those of this preset are known.
        like = replace(self.config, algorithm=qdenv.find_preset("dsage-laptop").algorithm)
        each = cpu_seconds(self.config) or cpu_seconds(like) or 0.0
        return each * max(self.config.evaluations - made, 0)

    def make(self, folders: Folders) -> None:
        """Begin or continue the run, then summarise it."""
        summarise(self.whole(folders), self.path(folders))
        read_summary.cache_clear()  # it holds what was kept before

    def whole(self, folders: Folders) -> RunDirectory:
        """Return the finished run with all its weights; see `whole_run`."""
        return whole_run(self.config, folders.runs / self.folder, folders.execution, say)

    def best(self, folders: Folders) -> RunDirectory:
        """Return a run with the weights of its best elites: what is kept, or the whole run."""
        kept = self.path(folders)
        return RunDirectory.open(kept) if (kept / ARCHIVE).exists() else self.whole(folders)

    def read(self, folders: Folders) -> Summary | None:
        """Read what is kept; None where nothing is."""
        path = self.path(folders)
        return read_summary(path) if (path / SUMMARY).exists() else None


# With the published surrogate DSAGE takes weeks on a CPU: fewer evaluations, and a small one whose
# networks go on from where they are, so that few epochs each time are enough.
_SMALL: tuple[tuple[str, Any], ...] = (
    *(("channels", 16), ("blocks", 1), ("epochs", 5), ("standardise", True), ("weights", ())),
    ("inner_iterations", 500),
)


def run_of(domain: str, ending: str = "") -> SavedRun:
    """Return the run of a domain by CMA-MAE, or by the preset with an `ending` like "dsage"."""
    if ending != "dsage":
        return SavedRun(f"{domain}-{ending}" if ending else domain)
    if domain == "warehouse-even":
        return SavedRun("dsage-laptop", evaluations=1000, row="warehouse-even-dsage")
    return SavedRun(f"{domain}-dsage", evaluations=1000, settings=_SMALL)


def whole_run(
    config: RunConfig,
    path: Path,
    execution: Execution = Execution(),  # noqa: B008 (frozen)
    report: Callable[[str], None] = lambda line: None,
    start: np.ndarray | None = None,
) -> RunDirectory:
    """Return the finished run of a folder; begin (at `start`) or continue it where it is not.

    Raises InputError if the folder holds a run with other settings.
    """
    interrupt.advise()  # the script goes on, not one of its runs
    if not (path / "config.json").exists():
        report(f"{path}: begins; an interruption loses minutes at most")
        return train(config, path, execution=execution, start=start)
    run = RunDirectory.open(path)
    if replace(run.config, evaluations=config.evaluations) != config:
        raise qdenv.InputError(f"{path}: a run with other settings: move it away")
    rows = run.read_metrics(salvage=True)
    if rows and rows[-1].evaluations >= config.evaluations and (path / ARCHIVE).exists():
        return run
    report(f"{path}: goes on")
    return resume(path, evaluations=config.evaluations, execution=execution)


def summarise(run: RunDirectory, target: Path) -> None:
    """Write what figures need of a run with an archive, in place of what the folder held.

    The folder can be opened as a run that has found its `BEST` elites only.
    """
    columns = run.archive.columns
    names = [measure.name for measure in run.measures]
    kept = {"cell": columns["index"], "objective": columns["objective"]}
    kept |= dict(zip(names, columns["measures"].T, strict=True))
    if "congested" in columns:
        kept["success"] = 1.0 - columns["congested"].mean(axis=1)
        kept["throughput"] = columns["throughput"].mean(axis=1, dtype=float)
        kept["similarity"] = columns["similarity"]
        kept["changed"] = (columns["unrepaired"] != columns["repaired"]).sum(axis=(1, 2))
    elif "success" in columns:
        kept["success"] = columns["success"].mean(axis=1)
        kept["shortest"] = columns["shortest"].mean(axis=1)
    order = np.argsort(kept["cell"])
    rows = zip(*([f"{value:.6g}" for value in kept[name][order]] for name in kept), strict=True)
    target.mkdir(parents=True, exist_ok=True)
    for name in FILES:
        shutil.copyfile(run.path / name, target / name)
    write_csv(target / SUMMARY, list(kept), rows)
    best = np.sort(np.argsort(-columns["objective"], kind="stable")[:BEST])
    elites = {name: values[best] for name, values in columns.items()}
    write_arrays(target / ARCHIVE, elites, compressed=True)


@cache
def read_summary(path: Path) -> Summary:
    """Read what `summarise` kept."""
    with (path / SUMMARY).open(newline="") as file:
        head, *rows = csv.reader(file)
    values = np.array(rows, dtype=float).reshape(len(rows), len(head))
    elites = dict(zip(head, values.T, strict=True))
    run = RunDirectory.open(path)
    return Summary(run.config, run.measures, run.read_metrics(), elites)
