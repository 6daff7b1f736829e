"""The run directory: configuration, manifest, metrics, checkpoints, archive, best layout.

RUN/config.json             every setting, resolved; enough to run it again
RUN/manifest.json           schema, measures, versions, device, git revision
RUN/start.npz               the generator from which the search began, if it was one
RUN/metrics.csv             one row per iteration
RUN/notes.csv               one row per iteration of what the algorithm says of itself, if it does
RUN/checkpoints/NUMBER.npz  the search after that iteration
RUN/archive.npz             one row per filled cell of the result archive
RUN/best_layout.json, archive.png, progress.png, notes.png, best_layout.png
RUN/.lock                   held by the process that writes here
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from qdenv.domains.base import make_domain
from qdenv.generate import GENERATORS
from qdenv.grid import parse
from qdenv.io.arrays import Column, read_arrays, write_arrays
from qdenv.io.files import damaged, sweep, write_csv, write_json
from qdenv.io.records import read_json
from qdenv.run.archive import (
    BestLayout,
    Elite,
    SavedArchive,
    mark_cells,
    read_columns,
)
from qdenv.run.config import RunConfig, config_from_json, config_to_json
from qdenv.run.log import Metrics, read_metrics
from qdenv.run.manifest import ArchiveSchema, check_schema, make_manifest, read_schema
from qdenv.types import InputError, Measure
from qdenv.zoo import Shipped, find

if TYPE_CHECKING:
    from qdenv.run.checkpoint import Manifest

_KEPT_CHECKPOINTS = 2
_START = "start.npz"


class _BestLayoutFile(NamedTuple):
    """What is read of best_layout.json."""

    layout: list[str]
    marks: Mapping[str, tuple[int, int]] = {}


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
        schema: ArchiveSchema,
        start: np.ndarray | None = None,
    ) -> RunDirectory:
        """Start a run's folder.

        Args:
            path: the folder; made if need be.
            config: the resolved configuration.
            schema: of the archive.
            start: parameters from which the search begins, float [P]; None for zeros.

        Raises:
            InputError: there is a run already, or the place cannot be written to.
        """
        run = cls(Path(path))
        if (run.path / "config.json").exists():
            raise InputError(f"{path}: holds a run already; `qdenv resume {path}` continues it")
        manifest = make_manifest(schema, make_domain(config.evaluation.domain))
        write_json(run.path / "manifest.json", manifest)
        run.write_metrics([])
        if start is not None:
            write_arrays(run.path / _START, {"solution": start})
        run.write_config(config)  # last: a folder with a configuration counts as a run
        return run

    @classmethod
    def open(cls, path: str | Path) -> RunDirectory:
        """Open an existing run.

        Args:
            path: its folder, or ``zoo:DOMAIN/NAME``; a folder of the zoo is ``zoo:DOMAIN``.

        Raises:
            InputError: there is none, or a newer qdenv wrote it.
        """
        shipped = find(path)
        run = cls(shipped.collection.folder, shipped) if shipped else cls(Path(path))
        if not (run.path / "config.json").exists():
            raise InputError(f"{path}: no run here (config.json is missing)")
        check_schema(run.path / "manifest.json")
        return run

    def locked(self) -> AbstractContextManager[None]:
        """Keep every other process from writing here.

        Raises:
            InputError: it ships with the package, and is only read.
        """
        self.demand_own()
        return locked(self.path)

    def demand_own(self) -> None:
        """Raise InputError if the folder is one of the zoo's, by name or by path."""
        if shipped := self.shipped or find(self.path):
            raise InputError(shipped.refusal)

    def __str__(self) -> str:
        """Say the run as command lines do."""
        return str(self.shipped or self.path)

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
        return read_schema(self.path / "manifest.json")

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
        """The archive as it was saved last, or an `InputError` where none was yet."""
        names = self.shipped.cells if self.shipped else {}
        return SavedArchive(self.load_archive(), self.schema, str(self), names)

    @property
    def best(self) -> Elite:
        """The best elite."""
        return self.archive.best

    def elite(
        self, which: str | Sequence[int] = "best", measures: Sequence[float] | None = None
    ) -> Elite:
        """Find an elite as `SavedArchive.elite` does: "best", "12,40", (12, 40), or by measures."""
        return self.archive.elite(which, measures)

    def __repr__(self) -> str:
        """Say where it is and how far it came."""
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

    def write_metrics(self, rows: list[Metrics]) -> None:
        """Replace metrics.csv."""
        write_csv(self.path / "metrics.csv", Metrics._fields, rows)

    def read_metrics(self, salvage: bool = False) -> list[Metrics]:
        """Read metrics.csv as `metrics.read_metrics` does."""
        return read_metrics(self.path / "metrics.csv", salvage)

    def save_checkpoint(self, iteration: int, state: Any, settings: dict[str, Any]) -> None:
        """Save the search after `iteration` and forget all but the newest checkpoints.

        Args:
            iteration: the last that is in `state`.
            state: of the search.
            settings: JSON-ready, what decides the run's result.
        """
        from qdenv.run.checkpoint import save_checkpoint  # imports jax and the archives

        target = self.path / "checkpoints" / f"{iteration:06d}.npz"
        save_checkpoint(target, state, {"iteration": iteration, "settings": settings})
        for old in self._checkpoints()[:-_KEPT_CHECKPOINTS]:
            old.unlink(missing_ok=True)

    def load_checkpoint(self, initial: Any) -> tuple[Manifest, Any]:
        """Load the newest checkpoint that is whole; says so where a newer one is not.

        Returns:
            (manifest, state); iteration 0 and `initial` where none is saved.

        Raises:
            InputError: all are damaged, or they are of another search or a newer qdenv.
        """
        from qdenv.run.checkpoint import load_newest  # imports jax and the archives

        return load_newest(self._checkpoints(), initial)

    def save_archive(self, elites: dict[str, np.ndarray]) -> None:
        """Write archive.npz: arrays with one row per elite."""
        write_arrays(self.path / "archive.npz", elites, compressed=True)

    def load_archive(self) -> dict[str, np.ndarray]:
        """Read archive.npz.

        Raises:
            InputError: there is none yet, or it is damaged.
        """
        path = self.path / "archive.npz"
        if not path.exists():
            hint = f"`qdenv resume {self.path}` goes on"
            raise InputError(f"{self.path}: no archive was saved yet; {hint}")
        return read_columns(path, self.schema)

    def read_best_layout(self) -> BestLayout | None:
        """Read best_layout.json; None where no layout succeeded yet.

        Raises:
            InputError: the file is damaged.
        """
        if self.shipped is not None:
            layout = self.best.layout
            marks = mark_cells(layout, make_domain(self.config.evaluation.domain))
            return BestLayout(layout, marks)
        path = self.path / "best_layout.json"
        if not path.exists():
            return None
        content = read_json(path, _BestLayoutFile)
        try:
            return BestLayout(parse(content.layout, self.tiles), dict(content.marks))
        except InputError as error:
            raise damaged(path, error) from error

    def _checkpoints(self) -> list[Path]:
        """List the checkpoints, the newest last; files of other names are not ours."""
        every = (self.path / "checkpoints").glob("*.npz")
        ours = (path for path in every if re.fullmatch(r"[0-9]{6,9}", path.stem))
        return sorted(ours, key=lambda path: int(path.stem))


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keep every other process from writing into a folder, which is made if need be.

    The system frees the lock when this process ends, however it ends. What a process that was
    killed left half written is taken away.

    Args:
        folder: the run directory.

    Raises:
        InputError: another process is at work there, or the place cannot be written to.
    """
    # Only here: it imports asyncio, a good part of what `check` takes altogether.
    import filelock

    lock = filelock.FileLock(folder / ".lock", blocking=False)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock.acquire()
    except filelock.Timeout:
        raise InputError(
            f"{folder}: another process is at work on this run: wait for it, or end it first"
        ) from None
    except OSError as error:
        raise InputError(f"{folder}: cannot be written to ({error.strerror or error})") from error
    try:
        for place in (folder, folder / "checkpoints"):
            sweep(place)
        yield
    finally:
        lock.release()


def find_start(config: RunConfig) -> np.ndarray | None:
    """Find the generator that `config.start` names: its parameters, float [P]; None for zeros.

    Raises:
        InputError: there is no such run or elite, or its generator is of another kind.
    """
    if not config.start:
        return None
    source, _, cell = config.start.partition("@")
    run = RunDirectory.open(source)
    found = run.archive.elite(cell or "best")
    tiles = make_domain(config.evaluation.domain).tiles
    if run.tiles != tiles:
        raise InputError(f"start {config.start}: it draws {run.tiles}, this domain has {tiles}")
    asked, kept = config.evaluation.generator, run.config.evaluation.generator
    if hasattr(kept, "steps") and type(asked) is type(kept):
        kept = replace(kept, steps=asked.steps)  # it grows for as long as it is asked to
    if asked != kept:
        names = [GENERATORS.name_of(one) for one in (kept, asked)]
        raise InputError(
            f"start {config.start}: its generator ({names[0]}) and this search's ({names[1]}) have "
            f"other settings: take those of {run}"
        )
    return found.solution


def read_start(run: RunDirectory) -> np.ndarray | None:
    """Read the start that a run keeps, float [P]; None for zeros.

    Raises:
        InputError: the file is missing or damaged.
    """
    if not run.config.start:
        return None
    path = run.path / _START
    if not path.exists():
        raise InputError(f"{path} is missing: copy it back, or train anew in another folder")
    return read_arrays(path, {"solution": Column("f", 1)}, None)["solution"]
