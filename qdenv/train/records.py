"""The run directory: configuration, manifest, metrics, checkpoints, archive, best layout.

RUN/config.json             every setting, resolved; enough to run it again
RUN/manifest.json           schema, versions, device, git revision
RUN/metrics.csv             one row per iteration
RUN/checkpoints/NUMBER.npz  the search after that iteration
RUN/archive.npz             one row per filled cell of the result archive
RUN/best_layout.json, archive.png, best_layout.png
"""

import csv
import dataclasses
import io
import json
import platform
import subprocess
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from qdenv.files import write_atomically
from qdenv.train.checkpoint import load_checkpoint, save_checkpoint
from qdenv.train.config import RunConfig, config_from_json, config_to_json
from qdenv.types import InputError, Measure

SCHEMA = 1
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


@dataclasses.dataclass(frozen=True)
class RunDirectory:
    """The files of one run; every write leaves either the old file or the new one."""

    path: Path

    @classmethod
    def create(
        cls, path: str | Path, config: RunConfig, measures: Sequence[Measure], tiles: str
    ) -> "RunDirectory":
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
        write_atomically(run.path / "manifest.json", _json(_manifest(measures, tiles)))
        run.write_metrics([])
        run.write_config(config)  # last: a folder with a configuration counts as a run
        return run

    @classmethod
    def open(cls, path: str | Path) -> "RunDirectory":
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
        write_atomically(self.path / "config.json", _json(config_to_json(config)))

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
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerows([Metrics._fields, *rows])
        write_atomically(self.path / "metrics.csv", text.getvalue().encode())

    def read_metrics(self) -> list[Metrics]:
        """Read metrics.csv; a last row cut off by a crash is left out.

        Raises:
            InputError: the file is missing or damaged.
        """
        try:
            rows = list(csv.reader(io.StringIO((self.path / "metrics.csv").read_text())))[1:]
            return [
                Metrics(int(row[0]), int(row[1]), *(float(value) for value in row[2:]))
                for row in rows
            ]
        except (OSError, ValueError, IndexError, TypeError) as error:
            raise InputError(f"{self.path}/metrics.csv: cannot be read ({error})") from error

    def save_checkpoint(self, iteration: int, state: Any, initial: Any) -> None:
        """Save the search after `iteration` and forget all but the newest checkpoints."""
        target = self.path / "checkpoints" / f"{iteration:06d}.npz"
        save_checkpoint(target, state, initial, {"iteration": iteration})
        for old in self._checkpoints()[:-KEPT_CHECKPOINTS]:
            old.unlink(missing_ok=True)

    def load_checkpoint(self, initial: Any) -> tuple[int, Any]:
        """Load the newest checkpoint: (iteration, state), or (0, `initial`) where none is."""
        saved = self._checkpoints()
        if not saved:
            return 0, initial
        state, manifest = load_checkpoint(saved[-1], initial)
        return manifest["iteration"], state

    def save_archive(self, elites: dict[str, np.ndarray]) -> None:
        """Write archive.npz: arrays with one row per filled cell."""
        write_atomically(
            self.path / "archive.npz", lambda file: np.savez_compressed(file, **elites)
        )

    def load_archive(self) -> dict[str, np.ndarray]:
        """Read archive.npz.

        Raises:
            InputError: there is none yet, or it is damaged.
        """
        try:
            with np.load(self.path / "archive.npz", allow_pickle=False) as file:
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


def _json(content: dict[str, Any]) -> bytes:
    return (json.dumps(content, indent=1) + "\n").encode()


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
