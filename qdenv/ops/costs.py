"""How long a search takes here: as measured on this machine, else estimated."""

import contextlib
import os
from collections.abc import Sequence
from pathlib import Path

from qdenv import devices
from qdenv.io.files import write_json
from qdenv.io.records import read_json
from qdenv.presets import find_preset
from qdenv.run.config import RunConfig, planner_of
from qdenv.run.log import Metrics
from qdenv.types import InputError

# CPU seconds of one evaluation, measured on two cores of a cloud machine. Those of DSAGE on the
# paper's rows are reckoned from `python -m experiments.benchmarks surrogate`, for outer loops of
# one batch of 50 (mazes: 400 evaluations) that learn from half of the evaluations.
_CPU_SECONDS = {
    "quick": 0.06,
    "laptop": 0.91,
    "warehouse-even": 0.91,
    "warehouse-uneven": 1.14,
    "manufacturing": 1.14,
    "manufacturing-quick": 0.092,
    "maze-walls": 0.023,
    "maze-entropy": 0.023,
    "maze-quick": 0.017,
    "dsage-quick": 0.25,
    "dsage-laptop": 4.8,
    "warehouse-even-dsage": 280.0,
    "warehouse-uneven-dsage": 280.0,
    "manufacturing-dsage": 280.0,
    "maze-walls-dsage": 60.0,
    "maze-entropy-dsage": 60.0,
}
_FEWEST_ROWS = 5  # iterations from which on a measurement counts: the first one compiles


def describe_cost(preset: str, config: RunConfig) -> str:
    """Return how long a configuration takes here, like "about 8 min"; "" where that is unknown.

    Args:
        preset: name of the preset that it was made from.
        config: the configuration.
    """
    base = _base_of(preset)
    usual = find_preset(preset) if base else config
    if hasattr(config.algorithm, "surrogate"):
        # What a surrogate learns is no part of what another algorithm takes.
        base = preset if type(usual.algorithm) is type(config.algorithm) else ""
    if planner_of(config) != planner_of(usual):  # which may take ten times as long
        return ""
    measured = base and (_read().get(preset) or _read().get(base))
    seconds = measured or _CPU_SECONDS.get(base, 0.0) / devices.count_cores()
    if not seconds:
        return ""
    source = "as measured here" if measured else "an estimate"
    return f"about {format_duration(seconds * config.evaluations)} ({source})"


def estimate_seconds(preset: str) -> float:
    """Return the CPU seconds of one evaluation of a preset that `_CPU_SECONDS` knows."""
    return _CPU_SECONDS[_base_of(preset)]


def _base_of(preset: str) -> str:
    """Return the preset whose evaluations cost as much, by its name; "" where there is none.

    Rows that differ in alpha or in the algorithm alone are called like ``warehouse-even-cma-es``.
    """
    bases = [name for name in _CPU_SECONDS if f"{preset}-".startswith(f"{name}-")]
    return max(bases, key=len, default="")


def format_duration(seconds: float) -> str:
    """Write a duration in a unit that leaves two or three digits."""
    for unit, length in {"days": 86400, "h": 3600, "min": 60}.items():
        if seconds >= 2.5 * length:
            return f"{seconds / length:.0f} {unit}"
    return f"{max(seconds, 1):.0f} s"


def remember(preset: str, rows: Sequence[Metrics]) -> None:
    """Save what an evaluation of a preset took on this machine, without compilation.

    Args:
        preset: its name.
        rows: the run's, one per iteration.
    """
    if len(rows) < _FEWEST_ROWS:
        return
    seconds = rows[-1].seconds - rows[0].seconds
    evaluations = rows[-1].evaluations - rows[0].evaluations
    # A home that cannot be written to is no reason to fail a run.
    with contextlib.suppress(InputError):
        write_json(_file(), _read() | {preset: float(f"{seconds / evaluations:.3g}")})


def _file() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "qdenv" / "costs.json"


def _read() -> dict[str, float]:
    try:
        return read_json(_file(), dict[str, float])
    except InputError:  # nothing was measured yet
        return {}
