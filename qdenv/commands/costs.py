"""What a search costs on this machine: measured here where one ran before, else estimated."""

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

# CPU seconds of one evaluation, measured on two cores of a cloud machine.
CPU_SECONDS = {
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
    # Reckoned: the surrogate's part from `python -m experiments.benchmarks surrogate`, for outer
    # loops of one batch of 50 (mazes: 400 evaluations) that learn from half of the evaluations.
    "dsage-laptop": 4.8,
    "warehouse-even-dsage": 280.0,
    "warehouse-uneven-dsage": 280.0,
    "manufacturing-dsage": 280.0,
    "maze-walls-dsage": 60.0,
    "maze-entropy-dsage": 60.0,
}
FEWEST_ROWS = 5


def describe_cost(preset: str, config: RunConfig) -> str:
    """Say how long a preset takes here, like "about 8 min"; "" where nothing is known."""
    base = _base_of(preset)
    usual = find_preset(preset) if base else config
    if hasattr(config.algorithm, "surrogate"):
        # What a surrogate learns is no part of what another algorithm takes.
        base = preset if type(usual.algorithm) is type(config.algorithm) else ""
    if planner_of(config) != planner_of(usual):  # which may take ten times as long
        return ""
    measured = base and (_read().get(preset) or _read().get(base))
    known = CPU_SECONDS.get(base)
    seconds = measured or (known / devices.count_cores() if known else None)
    if seconds is None:
        return ""
    how = "as measured here" if measured else "an estimate"
    return f"about {in_words(seconds * config.evaluations)} ({how})"


def reckon_seconds(preset: str) -> float:
    """Reckon the CPU seconds of one evaluation of a preset, which has a name in `CPU_SECONDS`."""
    return CPU_SECONDS[_base_of(preset)]


def _base_of(preset: str) -> str:
    """Find the preset whose evaluations cost as much, by its name; "" where there is none.

    Rows that differ in alpha or in the algorithm alone are called like ``warehouse-even-cma-es``.
    """
    bases = [name for name in CPU_SECONDS if f"{preset}-".startswith(f"{name}-")]
    return max(bases, key=len, default="")


def in_words(seconds: float) -> str:
    """Say a duration in the unit a person would choose."""
    for unit, length in {"days": 86400, "h": 3600, "min": 60}.items():
        if seconds >= 2.5 * length:
            return f"{seconds / length:.0f} {unit}"
    return f"{max(seconds, 1):.0f} s"


def remember(preset: str, rows: Sequence[Metrics]) -> None:
    """Keep what an evaluation of a preset took on this machine, compilation left out.

    Args:
        preset: its name.
        rows: the run's, one per iteration; too few tell nothing.
    """
    if len(rows) < FEWEST_ROWS:
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
    except InputError:  # nothing is remembered yet, or no more
        return {}
