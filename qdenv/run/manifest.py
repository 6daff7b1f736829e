"""The manifest of a run: what its archive means, and where and with what it was made."""

import contextlib
import platform
import subprocess
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, NamedTuple

from qdenv.domains.base import Domain
from qdenv.io.files import damaged
from qdenv.io.records import read_json
from qdenv.lazy import jax
from qdenv.search.axes import Axis, axes_of
from qdenv.types import InputError, Measure

_SCHEMA = 2  # of run directories; 1 was never released
_PACKAGES = ("qdenv", "jax", "jaxlib", "numpy", "flax", "qdax", "evosax", "highspy", "numba")


class ArchiveSchema(NamedTuple):
    """What the columns of a run's archive mean."""

    measures: tuple[Measure, ...]  # the axes of the archive
    tiles: str  # the alphabet of the layouts
    names: Mapping[str, str]  # how pictures call the tiles, by their symbols
    objective: str = "objective"  # what is maximised, with its unit
    # the column that chooses among elites of equal objective; None for none
    tie_break: str | None = None


def archive_schema(domain: Domain, measures: Sequence[Measure]) -> ArchiveSchema:
    """Make the schema of an archive of this domain over these axes."""
    axes, tiles = tuple(measures), domain.tiles
    return ArchiveSchema(axes, tiles, domain.names, domain.objective_name, domain.tie_break)


class _Manifest(NamedTuple):
    """What is read of a manifest; it holds more, for people."""

    measures: list[Axis]
    tiles: str
    tile_names: Mapping[str, str] = {}
    objective: str = "objective"
    tie_break: str | None = None


class _Written(NamedTuple):
    """What tells which qdenv wrote a manifest."""

    schema: int = 0


def read_schema(path: Path) -> ArchiveSchema:
    """Read the schema of an archive from a manifest.

    Raises:
        InputError: it cannot be read, or a part is missing or of another form.
    """
    content = read_json(path, _Manifest)
    axes = axes_of(content.measures, path)
    if not content.tiles:
        raise damaged(path, "tiles: there must be one")
    return ArchiveSchema(axes, content.tiles, *content[2:])


def check_schema(path: Path) -> None:
    """Refuse the manifest of a newer qdenv.

    Raises:
        InputError: it is one, or cannot be read.
    """
    if read_json(path, _Written).schema > _SCHEMA:
        raise InputError(f"{path.parent}: written by a newer qdenv, please upgrade")


def make_manifest(schema: ArchiveSchema, domain: Domain) -> dict[str, Any]:
    """Make the content of manifest.json of a run that begins now."""
    axes = ("name", "low", "high", "cells")
    return {
        "schema": _SCHEMA,
        "measures": [{axis: getattr(one, axis) for axis in axes} for one in schema.measures],
        "tiles": schema.tiles,
        "tile_names": dict(schema.names),
        "objective": schema.objective,
        "tie_break": schema.tie_break,
        "reads": dict(domain.reads()),
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": {"python": platform.python_version()} | package_versions(),
        "device": f"{jax.default_backend()}: {jax.devices()[0].device_kind}",
        "machine": platform.platform(),
        "git_revision": _git_revision(),
    }


def package_versions(packages: Sequence[str] = _PACKAGES) -> dict[str, str]:
    """Return the versions of packages, "not installed" for those that are not."""
    found = dict.fromkeys(packages, "not installed")
    for name in packages:
        with contextlib.suppress(PackageNotFoundError):
            found[name] = version(name)
    return found


def _git_revision() -> str | None:
    """Name the revision of the package's own checkout; None where it was installed."""
    command = ["git", "-C", str(Path(__file__).parent), "rev-parse", "HEAD"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return None
