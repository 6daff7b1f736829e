"""The run directory: configuration, manifest, metrics, checkpoints, archive, best layout.

RUN/config.json             every setting, resolved; enough to run it again
RUN/manifest.json           schema, versions, device, git revision
RUN/metrics.csv             one row per iteration
RUN/checkpoints/NUMBER.npz  the search after that iteration
RUN/archive.npz             one row per filled cell of the result archive
RUN/best_layout.json, archive.png, best_layout.png
"""

from __future__ import annotations

import csv
import dataclasses
import json
import platform
import subprocess
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, NamedTuple, get_type_hints

import numpy as np

from qdenv.checkpoints import write_arrays
from qdenv.files import write_csv, write_json
from qdenv.lazy import jax
from qdenv.training.config import RunConfig, config_from_json, config_to_json
from qdenv.types import InputError, Measure

SCHEMA = 2  # 1: one flat record for the numbers of every domain; still read
KEPT_CHECKPOINTS = 2
_PACKAGES = ("qdenv", "jax", "jaxlib", "numpy", "flax", "qdax", "evosax", "highspy", "numba")


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


@dataclasses.dataclass(frozen=True)
class RunDirectory:
    """The files of one run; every write leaves either the old file or the new one."""

    path: Path

    @classmethod
    def create(
        cls, path: str | Path, config: RunConfig, measures: Sequence[Measure], tiles: str
    ) -> RunDirectory:
        """Start a run's folder.

        Args:
            path: the folder; made if need be.
            config: the resolved configuration.
            measures: axes of the archive.
            tiles: alphabet of the layouts.

        Raises:
            InputError: there is a run already, or the place cannot be written to.
        """
        run = cls(Path(path))
        if (run.path / "config.json").exists():
            raise InputError(f"{path}: holds a run already; `qdenv resume {path}` continues it")
        write_json(run.path / "manifest.json", _manifest(measures, tiles))
        run.write_metrics([])
        run.write_config(config)  # last: a folder with a configuration counts as a run
        return run

    @classmethod
    def open(cls, path: str | Path) -> RunDirectory:
        """Open an existing run.

        Raises:
            InputError: there is none, or a newer qdenv wrote it.
        """
        run = cls(Path(path))
        if not (run.path / "config.json").exists():
            raise InputError(f"{path}: no run here (config.json is missing)")
        if run._read_json("manifest.json").get("schema", 0) > SCHEMA:
            raise InputError(f"{path}: written by a newer qdenv, please upgrade")
        return run

    def write_config(self, config: RunConfig) -> None:
        """Write config.json."""
        write_json(self.path / "config.json", config_to_json(config))

    @property
    def config(self) -> RunConfig:
        """The resolved configuration."""
        return config_from_json(self._read_json("config.json"), self.path / "config.json")

    @property
    def measures(self) -> tuple[Measure, ...]:
        """The axes of the archive."""
        axes = self._read_json("manifest.json")["measures"]
        return tuple(Measure(**axis) for axis in axes)

    @property
    def tiles(self) -> str:
        """The alphabet of the layouts."""
        return self._read_json("manifest.json")["tiles"]

    def write_metrics(self, rows: list[Metrics]) -> None:
        """Replace metrics.csv."""
        write_csv(self.path / "metrics.csv", Metrics._fields, rows)

    def read_metrics(self) -> list[Metrics]:
        """Read metrics.csv; columns that an older qdenv did not write take their defaults.

        Raises:
            InputError: the file is missing or damaged.
        """
        kinds = get_type_hints(Metrics)
        try:
            with (self.path / "metrics.csv").open(newline="") as file:
                return [
                    Metrics(**{name: kinds[name](value) for name, value in row.items()})
                    for row in csv.DictReader(file, strict=True)
                ]
        except (OSError, ValueError, KeyError, TypeError, csv.Error) as error:
            raise InputError(f"{self.path}/metrics.csv: cannot be read ({error})") from error

    def save_checkpoint(self, iteration: int, state: Any) -> None:
        """Save the search after `iteration` and forget all but the newest checkpoints."""
        from qdenv.training.checkpoint import save_checkpoint  # imports jax and the archives

        target = self.path / "checkpoints" / f"{iteration:06d}.npz"
        save_checkpoint(target, state, {"iteration": iteration})
        for old in self._checkpoints()[:-KEPT_CHECKPOINTS]:
            old.unlink(missing_ok=True)

    def load_checkpoint(self, initial: Any) -> tuple[int, Any]:
        """Load the newest checkpoint: (iteration, state), or (0, `initial`) where none is."""
        from qdenv.training.checkpoint import load_checkpoint

        saved = self._checkpoints()
        if not saved:
            return 0, initial
        state, manifest = load_checkpoint(saved[-1], initial)
        return manifest["iteration"], state

    def save_archive(self, elites: dict[str, np.ndarray]) -> None:
        """Write archive.npz: arrays with one row per filled cell."""
        write_arrays(self.path / "archive.npz", elites, compressed=True)

    def load_archive(self) -> dict[str, np.ndarray]:
        """Read archive.npz.

        Raises:
            InputError: there is none yet, or it is damaged.
        """
        try:
            with (
                open(self.path / "archive.npz", "rb") as stream,
                np.load(stream, allow_pickle=False) as file,
            ):
                return dict(file)
        except (OSError, ValueError, EOFError) as error:
            raise InputError(f"{self.path}/archive.npz: cannot be read ({error})") from error

    def _checkpoints(self) -> list[Path]:
        return sorted((self.path / "checkpoints").glob("[0-9]*.npz"))

    def _read_json(self, name: str) -> dict[str, Any]:
        try:
            content = json.loads((self.path / name).read_text())
        except (OSError, ValueError) as error:
            raise InputError(f"{self.path / name}: cannot be read ({error})") from error
        if not isinstance(content, dict):
            raise InputError(f"{self.path / name}: expected a JSON object")
        return content


def _manifest(measures: Sequence[Measure], tiles: str) -> dict[str, Any]:
    axes = ("name", "low", "high", "cells")
    return {
        "schema": SCHEMA,
        "measures": [{axis: getattr(measure, axis) for axis in axes} for measure in measures],
        "tiles": tiles,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": {"python": platform.python_version()}
        | {name: _version(name) for name in _PACKAGES},
        "device": f"{jax.default_backend()}: {jax.devices()[0].device_kind}",
        "machine": platform.platform(),
        "git_revision": _git_revision(),
    }


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def _git_revision() -> str | None:
    """Name the revision of the package's own checkout; None where it was installed."""
    command = ["git", "-C", str(Path(__file__).parent), "rev-parse", "HEAD"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return None
