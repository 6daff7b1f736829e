"""The manifest of a run: what its archive means, and where and with what it was made."""

import json
import platform
import subprocess
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, NamedTuple

from qdenv.domains.base import Domain
from qdenv.lazy import jax
from qdenv.search.axes import check_measures
from qdenv.types import InputError, Measure

SCHEMA = 2  # 1: one flat record for the numbers of every domain; still read
_PACKAGES = ("qdenv", "jax", "jaxlib", "numpy", "flax", "qdax", "evosax", "highspy", "numba")


class Meaning(NamedTuple):
    """What the columns of a run's archive mean.

    Attributes:
        measures: the axes of the archive.
        tiles: the alphabet of the layouts.
        names: how pictures call the tiles, by their symbols.
        objective: what is maximised, with its unit.
        tie_break: the column that chooses among elites of equal objective; None for none.
    """

    measures: tuple[Measure, ...]
    tiles: str
    names: Mapping[str, str]
    objective: str = "objective"
    tie_break: str | None = None


def meaning_of(domain: Domain, measures: Sequence[Measure]) -> Meaning:
    """Say what an archive of this domain means, over these axes."""
    axes, tiles = tuple(measures), domain.tiles
    return Meaning(axes, tiles, domain.names, domain.objective_name, domain.tie_break)


def read_meaning(content: dict[str, Any], source: Path) -> Meaning:
    """Read the meaning out of a manifest.

    Raises:
        InputError: a part is missing or of another form; the line names `source`.
    """
    try:
        axes = check_measures([Measure(**axis) for axis in content["measures"]])
        tiles, objective = content["tiles"], content.get("objective", "objective")
        names, tie_break = dict(content.get("tile_names", {})), content.get("tie_break")
        if not (isinstance(tiles, str) and tiles and isinstance(objective, str)):
            raise TypeError("tiles and objective must be words")
        if not isinstance(tie_break, str | None):
            raise TypeError("tie_break must be a word")
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{source}: no manifest of a run ({error})") from error
    return Meaning(axes, tiles, names, objective, tie_break)


def read_object(path: Path) -> dict[str, Any]:
    """Read a JSON object of a run.

    Raises:
        InputError: it cannot be read, or is none.
    """
    try:
        content = json.loads(path.read_text())
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path}: cannot be read ({error})") from error
    if not isinstance(content, dict):
        raise InputError(f"{path}: expected a JSON object")
    return content


def check_schema(content: dict[str, Any], source: Path) -> None:
    """Refuse the manifest of a newer qdenv.

    Raises:
        InputError: it is one, or it does not say which schema it has.
    """
    schema = content.get("schema", 0)
    if not isinstance(schema, int):
        raise InputError(f"{source}: no manifest of a run (schema {schema!r} is no number)")
    if schema > SCHEMA:
        raise InputError(f"{source.parent}: written by a newer qdenv, please upgrade")


def make_manifest(meaning: Meaning) -> dict[str, Any]:
    """List what manifest.json holds of a run that begins now."""
    axes = ("name", "low", "high", "cells")
    return {
        "schema": SCHEMA,
        "measures": [{axis: getattr(one, axis) for axis in axes} for one in meaning.measures],
        "tiles": meaning.tiles,
        "tile_names": dict(meaning.names),
        "objective": meaning.objective,
        "tie_break": meaning.tie_break,
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
