"""What a search takes: as measured here for equal settings, else an estimate that scales with them.

CPU seconds on one core of a cloud machine, for what runs of the presets took in all:

| part of an evaluation | grows with                                        |
| search and growth     | cells and steps of growth                         |
| repair                | cells; aisles or racks that are prescribed        |
| simulation            | agents (robots), timesteps, simulations, planner  |
| surrogate of DSAGE    | cells, for the settings of a preset only          |
"""

import contextlib
import hashlib
from collections.abc import Sequence
from pathlib import Path

import platformdirs

from qdenv import devices
from qdenv.configurations import PRESETS
from qdenv.domains.base import make_domain
from qdenv.io.files import write_json
from qdenv.io.records import read_json
from qdenv.ops.output import format_duration
from qdenv.run.config import RunConfig, override, planner_of
from qdenv.run.directory import Metrics
from qdenv.search.registry import ALGORITHMS
from qdenv.simulation.mapf.negotiated.settings import LOW
from qdenv.simulation.mapf.settings import OWN, PLANNERS
from qdenv.types import InputError

_SEARCH = 0.012  # asking, telling, and what a small evaluation takes besides
_GROWTH = 4e-7  # of one cell in one step
_REPAIR = 1e-4  # of one cell
_SHAPED = 3.0  # times as long, where rules prescribe aisles or racks
_USUAL_CELLS = 33 * 36
# Of one agent's timestep at that size, averaged over searches, where many runs end early.
_STEP = {"low": 0.8e-6, OWN: 4e-6, "pibt": 0.25e-6, "pbs": 3e-5}
_MAZE_STEP = 3.4e-7
# Of learning from one evaluation, at the preset's size. Those on the paper's rows are reckoned from
# `python -m experiments.benchmarks surrogate`, for outer loops of one batch of 50 (mazes: 400
# evaluations) that learn from half of the evaluations.
_LEARNING = {
    "dsage-quick": 0.19,
    "dsage-laptop": 3.9,
    "warehouse-even-dsage": 279.0,
    "manufacturing-dsage": 279.0,
    "maze-walls-dsage": 60.0,
    "maze-entropy-dsage": 60.0,
}
_COMPILING = 10.0  # before the first evaluation, by the clock


def cpu_seconds(config: RunConfig) -> float | None:
    """Estimate the CPU seconds of one evaluation; None where nothing is known of a part of it."""
    evaluation, domain = config.evaluation, make_domain(config.evaluation.domain)
    cells, horizon = domain.shape[0] * domain.shape[1], domain.config.horizon
    seconds = _SEARCH + _GROWTH * cells * getattr(evaluation.generator, "steps", 0)
    if domain.rules is not None:
        seconds += _REPAIR * cells * (_SHAPED if domain.rules().covers else 1)
    step, planner = _MAZE_STEP, planner_of(config)
    if planner is not None:
        name = "low" if planner == LOW else PLANNERS.name_of(planner)
        if name not in _STEP:
            return None
        # Farther goals take more search.
        step = _STEP[name] * domain.config.fleet.agents * (cells / _USUAL_CELLS) ** 0.2
    if horizon is None:
        return None
    seconds += step * horizon * evaluation.simulations
    if hasattr(config.algorithm, "surrogate"):
        known = [name for name in _LEARNING if PRESETS[name].algorithm == config.algorithm]
        if not known:
            return None
        usual = PRESETS[known[0]].evaluation.domain
        seconds += _LEARNING[known[0]] * cells / (usual.rows * usual.cols)
    return seconds


def describe_cost(config: RunConfig) -> str:
    """Return how long a search takes here, like "about 8 min (an estimate)"; "" if unknown."""
    measured = _read_costs()[1].get(_key(config))
    if measured is not None:
        return f"about {format_duration(measured * config.evaluations)} (as measured here)"
    seconds = cpu_seconds(config)
    if seconds is None:
        return ""
    # All cores share them.
    total = seconds * config.evaluations / devices.count_cores() + _COMPILING
    return f"about {format_duration(total)} (an estimate)"


def remember_cost(config: RunConfig, rows: Sequence[Metrics]) -> None:
    """Save what an evaluation took on this machine, by the rows of a run's log."""
    # Too few rows tell nothing: the first iteration compiles, which is left out below.
    if len(rows) < 5 or not platformdirs.user_cache_path().is_absolute():  # a user without a home
        return
    seconds = rows[-1].seconds - rows[0].seconds
    evaluations = rows[-1].evaluations - rows[0].evaluations
    # A home that cannot be written to is no reason to fail a run.
    with contextlib.suppress(InputError):
        file, costs = _read_costs()
        write_json(file, costs | {_key(config): float(f"{seconds / evaluations:.3g}")})


def _key(config: RunConfig) -> str:
    """Hash the settings that the time of an evaluation depends on, but not where it runs."""
    ignored = {"evaluation__repair__workers": None, "evaluation__alpha": 0.0}
    evaluation, name = override(config, ignored).evaluation, ALGORITHMS.name_of(config.algorithm)
    return hashlib.blake2b(repr((evaluation, name, config.algorithm)).encode()).hexdigest()[:16]


def _read_costs() -> tuple[Path, dict[str, float]]:
    """Return the file of seconds for an evaluation, by settings, and what it holds so far."""
    file, costs = platformdirs.user_cache_path("qdenv") / "costs.json", {}
    with contextlib.suppress(InputError):  # nothing was measured yet
        costs = read_json(file, dict[str, float])
    return file, costs
