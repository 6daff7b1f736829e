"""The run directory: configuration, manifest, metrics, checkpoints, archive, best layout.

RUN/config.json             every setting, resolved; enough to run it again
RUN/manifest.json           schema, measures, versions, device, git revision
RUN/start.npz               the generator from which the search began, if it was one
RUN/metrics.csv             one row per iteration
RUN/notes.csv               one row per iteration of the algorithm's own numbers, if it has any
RUN/checkpoints/NUMBER.npz  the search after that iteration
RUN/archive.npz             one row per filled cell of the result archive
RUN/best_layout.json, archive.png, progress.png, notes.png, best_layout.png
RUN/.lock                   held by the process that writes here
"""

from __future__ import annotations

import contextlib
import dataclasses
import platform
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from qdenv.domains.base import make_domain
from qdenv.generate import GENERATORS
from qdenv.io.arrays import Column, read_arrays, write_arrays
from qdenv.io.files import damaged, sweep, write_csv, write_json
from qdenv.io.records import read_json
from qdenv.lazy import jax
from qdenv.run.archive import ArchiveSchema, Elite, SavedArchive
from qdenv.run.config import RunConfig, config_from_json, config_to_json
from qdenv.run.log import METRICS, Metrics, read_metrics
from qdenv.search.axes import Axis, axes_of
from qdenv.shipped import HOME, Shipped, find
from qdenv.types import InputError, Measure

_SCHEMA = 2  # of run directories; 1 was never released
_PACKAGES = ("qdenv", "jax", "jaxlib", "numpy", "flax", "qdax", "evosax", "highspy", "numba")


class _Version(NamedTuple):
    """What is read first of a manifest: the rest of a newer one may be of another form."""

    schema: int = 0


class _Manifest(NamedTuple):
    """What is read of a manifest; it holds more, for people."""

    measures: list[Axis]
    tiles: str
    tile_names: Mapping[str, str] = {}
    objective: str = "objective"
    tie_break: str | None = None


@dataclasses.dataclass(frozen=True, repr=False)
class RunDirectory:
    """The files of one run in the folder `path`; every write leaves the old file or the new one.

    `shipped` says which generator of the zoo it is, which is only read; None for one's own run.
    """

    path: Path
    shipped: Shipped | None = None

    @classmethod
    def create(
        cls,
        path: str | Path,
        config: RunConfig,
        measures: Sequence[Measure],
        start: np.ndarray | None = None,
    ) -> RunDirectory:
        """Start a run's folder, which is made if need be, or raise InputError if it holds one.

        `config` is resolved; `measures` are the axes of the archive, `start` the parameters from
        which the search begins, float [P], or None for zeros.
        """
        run = cls(Path(path))
        if (run.path / "config.json").exists():
            raise InputError(f"{path}: holds a run already; `qdenv resume {path}` continues it")
        git = ["git", "-C", str(Path(__file__).parent), "rev-parse", "HEAD"]
        try:
            output = subprocess.run(git, capture_output=True, text=True, check=True).stdout
            revision = output.strip()
        except (OSError, subprocess.CalledProcessError):  # the package was installed
            revision = None
        domain = make_domain(config.evaluation.domain)
        manifest = {
            "schema": _SCHEMA,
            "measures": [Axis(*measure[:4])._asdict() for measure in measures],
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
        if start is not None:
            write_arrays(run.path / "start.npz", {"solution": start})
        run.write_config(config)  # last: a folder with a configuration counts as a run
        return run

    @classmethod
    def open(cls, path: str | Path) -> RunDirectory:
        """Open an existing run: its folder, or ``zoo:DOMAIN/NAME``.

        Raises InputError if there is none, or a newer qdenv wrote it.
        """
        shipped = find(path)
        run = cls(HOME / shipped.collection.domain, shipped) if shipped else cls(Path(path))
        if not (run.path / "config.json").exists():
            raise InputError(f"{path}: no run here (config.json is missing)")
        if read_json(run.path / "manifest.json", _Version).schema > _SCHEMA:
            raise InputError(f"{run.path}: written by a newer qdenv, please upgrade")
        return run

    @contextlib.contextmanager
    def locked(self) -> Iterator[None]:
        """Keep every other process from writing here; the folder is made if need be.

        The system frees the lock when this process ends, however it ends. What a process that was
        killed left half written is deleted. Raises InputError if another process is at work here,
        the place cannot be written to, or it ships with the package.
        """
        # Here: it imports asyncio, a good part of what `check` takes altogether.
        import filelock

        self.demand_own()
        lock = filelock.FileLock(self.path / ".lock", blocking=False)
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            lock.acquire()
        except filelock.Timeout:
            raise InputError(
                f"{self.path}: another process is at work on this run: wait for it, or end it first"
            ) from None
        except OSError as error:
            reason = error.strerror or error
            raise InputError(f"{self.path}: cannot be written to ({reason})") from error
        try:
            for place in (self.path, self.path / "checkpoints"):
                sweep(place)
            yield
        finally:
            lock.release()

    def demand_own(self) -> None:
        """Raise InputError if the folder is one of the zoo's, by name or by path."""
        if shipped := self.shipped or find(self.path):
            raise InputError(shipped.refusal)

    def write_config(self, config: RunConfig) -> None:
        """Write config.json."""
        write_json(self.path / "config.json", config_to_json(config))

    @property
    def config(self) -> RunConfig:
        """The resolved configuration."""
        path = self.path / "config.json"
        return config_from_json(read_json(path, dict[str, Any]), path)

    @property
    def schema(self) -> ArchiveSchema:
        """What the archive means: its axes, the alphabet of its layouts, its objective."""
        path = self.path / "manifest.json"
        content = read_json(path, _Manifest)
        axes = axes_of(content.measures, path)
        if not content.tiles:
            raise damaged(path, "tiles: there must be one")
        return ArchiveSchema(axes, *content[1:])

    @property
    def measures(self) -> tuple[Measure, ...]:
        """The axes of the archive."""
        return self.schema.measures

    @property
    def tiles(self) -> str:
        """The alphabet of the layouts."""
        return self.schema.tiles

    @property
    def archive(self) -> SavedArchive:
        """The archive as it was saved last; `InputError` if none was yet, or it is damaged."""
        path = self.path / "archive.npz"
        if not path.exists():
            hint = f"`qdenv resume {self.path}` goes on"
            raise InputError(f"{self.path}: no archive was saved yet; {hint}")
        names = self.shipped.cells if self.shipped else {}
        return SavedArchive.read(path, self.schema, str(self), names)

    @property
    def best(self) -> Elite:
        """The best elite."""
        return self.archive.best

    def elite(
        self, which: str | Sequence[int] = "best", measures: Sequence[float] | None = None
    ) -> Elite:
        """Find an elite as `SavedArchive.elite` does: "best", "12,40", (12, 40), or by measures."""
        return self.archive.elite(which, measures)

    def read_metrics(self, salvage: bool = False) -> list[Metrics]:
        """Read metrics.csv as `log.read_metrics` does."""
        return read_metrics(self.path / METRICS, salvage)

    def read_start(self) -> np.ndarray | None:
        """Read the parameters from which the search began, float [P]; None for zeros.

        Raises InputError if the file is missing or damaged.
        """
        if not self.config.start:
            return None
        path = self.path / "start.npz"
        if not path.exists():
            raise InputError(f"{path} is missing: copy it back, or train anew in another folder")
        return read_arrays(path, {"solution": Column("f", 1)}, None)["solution"]

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
        try:
            archive = self.archive
            best = archive.best._repr_html_() if len(archive) else ""
            return f"<p>{self!r}</p>{archive._repr_html_()}{best}"
        except InputError as error:
            return f"<p>{self!r}</p><p>{error}</p>"


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
    source, _, cell = config.start.partition("@")
    run = RunDirectory.open(source)
    elite = run.archive.elite(cell or "best")
    tiles = make_domain(config.evaluation.domain).tiles
    if run.tiles != tiles:
        raise InputError(f"start {config.start}: it draws {run.tiles}, this domain has {tiles}")
    theirs, ours = run.config.evaluation.generator, config.evaluation.generator
    if hasattr(theirs, "steps") and type(ours) is type(theirs):
        theirs = replace(theirs, steps=ours.steps)  # the same automaton grows for any time
    if ours != theirs:
        names = [GENERATORS.name_of(one) for one in (theirs, ours)]
        raise InputError(
            f"start {config.start}: its generator ({names[0]}) and this search's ({names[1]}) have "
            f"other settings: take those of {run}"
        )
    return elite.solution
