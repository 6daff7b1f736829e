"""The run directory: configuration, manifest, metrics, checkpoints, archive, best layout.

RUN/config.json             every setting, resolved; enough to run it again
RUN/manifest.json           schema, measures, versions, device, git revision
RUN/start.npz               the parameters with which the search began, unless they were zeros
RUN/metrics.csv             one row per iteration
RUN/notes.csv               one row per iteration of the algorithm's own numbers, if it has any
RUN/checkpoints/NUMBER.npz  the search after that iteration
RUN/archive.npz             one row per filled cell of the result archive
RUN/best_layout.json, archive.png, progress.png, notes.png, best_layout.png
RUN/.qdenv-lock             held by the process that writes here
"""

from __future__ import annotations

import contextlib
import html
import logging
import math
import platform
import subprocess
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from shlex import quote
from typing import Any, NamedTuple, TypeVar

import numpy as np

from qdenv.domains.base import make_domain
from qdenv.generators import GENERATORS, GuidedNcaConfig, NcaConfig
from qdenv.grid import NUM_MOVES
from qdenv.guidance import NUM_SMOOTH
from qdenv.io.arrays import Column, read_arrays, write_arrays
from qdenv.io.files import damaged, locked, refuse_second_run, write_csv, write_json
from qdenv.io.records import parse_cell, read_json, read_rows, read_table, structured
from qdenv.lazy import jax
from qdenv.run.archive import ArchiveSchema, Elite, SavedArchive
from qdenv.run.config import RunConfig, config_from_json, config_to_json
from qdenv.search.axes import check_measures
from qdenv.shipped import HOME, USUAL, Shipped, find, refuse_inside
from qdenv.types import InputError, Measure

_SCHEMA = 2  # of run directories; 1 was never released
_AXIS = ("name", "low", "high", "cells")  # fields of a `Measure` in manifest.json
_PACKAGES = ("qdenv", "jax", "jaxlib", "numpy", "flax", "qdax", "evosax", "highspy", "numba")

METRICS, NOTES = "metrics.csv", "notes.csv"
_FREE = ("steps", "arithmetic")  # settings of a generator that its start need not share
_LOG = logging.getLogger(__name__)
Note = dict[str, float]  # numbers by name, like a surrogate's losses; NaN where there is none
T = TypeVar("T")


class Metrics(NamedTuple):
    """One row of metrics.csv: the search after an iteration."""

    iteration: int
    evaluations: int
    qd_score: float
    coverage: float
    best_objective: float
    seconds: float  # wall clock, summed over interruptions
    failed_repairs: int = 0  # of this iteration's layouts, those without a feasible repair
    congested_runs: int = 0  # of this iteration's simulations

    def __str__(self) -> str:
        """Show how the search stands."""
        best = f"best {self.best_objective:.3f}"
        return f"QD-score {self.qd_score:.1f}, coverage {self.coverage:.1%}, {best}"


@dataclass(frozen=True, repr=False)
class RunDirectory:
    """The files of one run; every write leaves the old file or the new one.

    A generator of the zoo is only read.
    """

    path: Path  # of the folder
    shipped: Shipped | None = None  # which generator of the zoo it is; None for one's own run

    @classmethod
    def create(
        cls,
        path: str | Path,
        config: RunConfig,
        measures: Sequence[Measure],
        start: np.ndarray | None = None,
    ) -> RunDirectory:
        """Start a run in the folder `path`, which is made if need be.

        `config` holds every setting, resolved; `measures` are the axes of the archive, `start` the
        parameters from which the search begins (float [P], None for zeros). Raises InputError if
        the folder holds a run already, or belongs to the zoo.
        """
        run = cls(Path(path))
        run.demand_new()
        here = Path(__file__)
        # The second is refused where the package was installed into another repository.
        git = ["git", "-C", str(here.parent), "rev-parse", "HEAD", f"HEAD:./{here.name}"]
        try:
            revision, _ = subprocess.check_output(git, text=True, stderr=subprocess.DEVNULL).split()
        except (OSError, subprocess.CalledProcessError):  # the package was installed
            revision = None
        domain = make_domain(config.evaluation.domain)
        manifest = {
            "schema": _SCHEMA,
            "measures": [dict(zip(_AXIS, measure[:4], strict=True)) for measure in measures],
            "tiles": domain.tiles,
            "tile_names": domain.names,
            "objective": domain.objective_name,
            "tie_break": domain.tie_break,
            "reads": dict(domain.reads()),
            "created": datetime.now(UTC).isoformat(timespec="seconds"),
            "versions": {"python": platform.python_version()} | package_versions(),
            "device": f"{jax.default_backend()}: {jax.devices()[0].device_kind}",
            "machine": platform.platform(),
            "git_revision": revision,
        }
        write_json(run.path / "manifest.json", manifest)
        write_csv(run.path / METRICS, Metrics._fields, [])
        place = run.path / "start.npz"
        place.unlink(missing_ok=True)  # of a process that was killed here
        if start is not None:
            write_arrays(place, {"solution": start})
        run.write_config(config)  # last: a folder with a configuration counts as a run
        return run

    @classmethod
    def open(cls, path: str | Path) -> RunDirectory:
        """Open the run at `path`, its folder or ``zoo:DOMAIN/NAME``.

        Raises InputError if there is no run, or a newer qdenv wrote it.
        """
        shipped = find(path)
        run = cls(HOME / shipped.collection.domain, shipped) if shipped else cls(Path(str(path)))
        for name in ("config.json", "manifest.json"):
            if not (run.path / name).exists():
                inside = sorted(one.parent.name for one in run.path.glob("*/manifest.json"))
                runs = f"; choose one of those in it: {', '.join(inside[:8])}" if inside else ""
                raise InputError(f"{path}: no run here ({name} is missing){runs}")
        # Before the rest, which may be of another form in a newer one.
        path = run.path / "manifest.json"
        schema = structured(read_json(path, dict[str, Any]).get("schema", 0), int, path)
        if schema > _SCHEMA:
            raise InputError(f"{run.path}: written by a newer qdenv, please upgrade")
        return run

    @contextlib.contextmanager
    def locked(self) -> Iterator[None]:
        """Keep every other process from writing here while the context lasts.

        Raises InputError if another process is at work on this run, or it is of the zoo.
        """
        self.demand_own()
        with locked(self.path):
            yield

    def demand_own(self) -> None:
        """Raise InputError if the folder is one of the zoo's, by name or by path, or is a file."""
        if shipped := self.shipped or find(self.path):
            train = f"`qdenv train {shipped.collection.origin.run}` makes a run of your own"
            raise InputError(f"{shipped}: ships with qdenv and stays as it is: {train}")
        if self.path.exists() and not self.path.is_dir():
            raise InputError(f"{self.path}: that is a file: name a folder")
        refuse_inside(self.path)

    def demand_new(self) -> None:
        """Raise InputError if a new run would replace anything here, or the zoo is here."""
        self.demand_own()
        begun: tuple[str, ...] = ()
        with contextlib.suppress(InputError):
            if "schema" in read_json(self.path / "manifest.json", dict[str, Any]):  # ours
                begun = ("manifest.json", METRICS, "start.npz")
        refuse_second_run(self.path, begun)

    def write_config(self, config: RunConfig) -> None:
        """Write `config` as config.json."""
        write_json(self.path / "config.json", config_to_json(config))

    @property
    def config(self) -> RunConfig:
        """Every setting, resolved; `InputError` if config.json is damaged."""
        path = self.path / "config.json"
        return config_from_json(read_json(path, dict[str, Any]), path)

    @property
    def schema(self) -> ArchiveSchema:
        """What the archive means; `InputError` if manifest.json is damaged."""
        path = self.path / "manifest.json"
        schema = read_json(path, ArchiveSchema)
        try:
            schema = schema._replace(measures=check_measures(schema.measures))
        except InputError as error:
            raise damaged(path, error) from error
        if not schema.tiles:
            raise damaged(path, "tiles: there must be one")
        return schema

    @property
    def tiles(self) -> str:
        """The symbols of the tiles of its layouts."""
        return self.schema.tiles

    @property
    def measures(self) -> tuple[Measure, ...]:
        """The axes of the archive."""
        return self.schema.measures

    @property
    def archive(self) -> SavedArchive:
        """The archive as it was saved last; `InputError` if none was yet, or it is damaged."""
        path = self.path / "archive.npz"
        if not path.exists():
            hint = f"`qdenv resume {quote(str(self.path))}` goes on"
            raise InputError(f"{self.path}: no archive was saved yet; {hint}")
        names: dict[str, tuple[int, ...]] = {}  # of cells; "best" is the generator's own
        if self.shipped:
            names = {one.name: one.cell for one in self.shipped.collection.generators}
            names[USUAL] = self.shipped.generator.cell
        return SavedArchive.read(path, self.schema, str(self), names)

    @property
    def best(self) -> Elite:
        """The best elite; `InputError` as for `archive`, or if no solution succeeded yet."""
        return self.archive.best

    def elite(
        self, which: str | Sequence[int] = "best", measures: Sequence[float] | None = None
    ) -> Elite:
        """Find an elite by `which`, or by `measures`, as `SavedArchive.elite` does."""
        return self.archive.elite(which, measures)

    def read_metrics(self, salvage: bool = False) -> list[Metrics]:
        """Read metrics.csv, a row for each iteration; missing columns take their defaults.

        Raises InputError if the file is missing or damaged; with `salvage` the rows before a damage
        are returned, and it is logged.
        """
        return _collect(read_table(self.path / METRICS, Metrics), salvage)

    def read_progress(self) -> list[Metrics]:
        """Read metrics.csv as `read_metrics` does; InputError if no iteration is finished."""
        if rows := self.read_metrics():
            return rows
        raise InputError(f"{self}: nothing is done yet; `qdenv resume {quote(str(self))}` begins")

    def read_notes(self, salvage: bool = False) -> list[Note]:
        """Read notes.csv, the algorithm's own numbers by name, a row for each iteration.

        There are none where the algorithm has no notes. `salvage` and damage as in `read_metrics`.
        """
        path = self.path / NOTES
        return _collect(_iterate_notes(path), salvage) if path.exists() else []

    def read_start(self) -> np.ndarray | None:
        """Read the parameters from which the search began, float [P]; None for zeros.

        Raises InputError if the file is damaged, or missing though the settings name a start.
        """
        path = self.path / "start.npz"
        if path.exists():
            return read_arrays(path, {"solution": Column("f", 1)}, None)["solution"]
        if self.config.start:
            raise InputError(f"{path} is missing: copy it back, or train in another folder")
        return None

    def __str__(self) -> str:
        """Name the run as command lines do."""
        return str(self.shipped or self.path)

    def __repr__(self) -> str:
        """Show where it is and how far it came."""
        try:
            last = self.read_metrics()[-1]
        except (InputError, IndexError):
            return f"RunDirectory({str(self)!r})"
        return (
            f"RunDirectory({str(self)!r}: {last.evaluations} evaluations, "
            f"QD-score {last.qd_score:.4g}, coverage {last.coverage:.1%}, "
            f"best {last.best_objective:.4g})"
        )

    def _repr_html_(self) -> str:
        """Draw the archive and the best layout, for notebooks."""
        title = f"<p>{html.escape(repr(self))}</p>"
        try:
            archive = self.archive
            best = archive.best._repr_html_() if len(archive) else ""
            return f"{title}{archive._repr_html_()}{best}"
        except InputError as error:
            return f"{title}<p>{html.escape(str(error))}</p>"


def _iterate_notes(path: Path) -> Iterator[Note]:
    for number, row in enumerate(read_rows(path), start=1):
        if not row.keys() >= {"iteration", "evaluations"}:
            raise damaged(path, "one of the columns evaluations, iteration is missing")
        try:
            yield {
                name: parse_cell(text, float, infinite=True) if text else math.nan
                for name, text in row.items()
            }
        except ValueError as error:
            raise damaged(path, f"row {number}: {error}") from error


def _collect(rows: Iterable[T], salvage: bool) -> list[T]:
    collected = []
    try:
        for row in rows:  # one by one: those before the damage count
            collected.append(row)
    except InputError as error:
        if not salvage:
            raise
        _LOG.warning("%s: what follows row %d is lost", error, len(collected))
    return collected


def package_versions(packages: Sequence[str] = _PACKAGES) -> dict[str, str]:
    """Return the versions of packages, "not installed" for those that are not."""
    versions = dict.fromkeys(packages, "not installed")
    for name in packages:
        with contextlib.suppress(PackageNotFoundError):
            versions[name] = version(name)
    return versions


def find_start(config: RunConfig) -> np.ndarray | None:
    """Find the generator that `config.start` names: its parameters, float [P]; None for zeros.

    Raises InputError if there is no such run or elite, or its generator is of another kind.
    """
    if not config.start:
        return None
    source, found, cell = str(config.start).rpartition("@")
    if not found or "/" in cell:  # the sign may be part of a folder's name
        source, cell = config.start, ""
    run = RunDirectory.open(source)
    elite = run.archive.elite(cell or "best")
    domain = make_domain(config.evaluation.domain)
    drawn = make_domain(run.config.evaluation.domain).generated
    if drawn != domain.generated:
        ours = domain.generated
        raise InputError(f"start {config.start}: it draws {drawn}, this domain has {ours}")
    theirs, ours = run.config.evaluation.generator, config.evaluation.generator
    # The same weights grow for any time, and draw much alike in either arithmetic.
    free = {name: getattr(ours, name) for name in _FREE if hasattr(ours, name)}
    if type(ours) is type(theirs):
        theirs = replace(theirs, **free)
    solution, kinds = elite.solution, len(domain.generated)
    if type(theirs) is NcaConfig and isinstance(ours, GuidedNcaConfig):
        from qdenv.nca import add_channels  # imports flax

        more = {**free, "base": ours.base, "smooth": ours.smooth}
        if ours.smooth:
            solution = np.pad(solution, (0, NUM_SMOOTH))
        else:
            solution = add_channels(solution, kinds, NUM_MOVES, theirs.kernel_sizes, theirs.hidden)
        theirs = GuidedNcaConfig(**vars(theirs) | more)
    if ours != theirs:
        about = f"start {config.start}: its generator"
        if type(ours) is not type(theirs):
            names = [GENERATORS.name_of(one) for one in (theirs, ours)]
            cure = f"give --generator {names[0]}, or leave --start out"
            raise InputError(f"{about} is {names[0]}, not {names[1]}: {cure}")
        other = [name for name, value in vars(theirs).items() if value != getattr(ours, name)]
        raise InputError(f"{about} differs in {', '.join(other)}: take those of {run}")
    return solution
