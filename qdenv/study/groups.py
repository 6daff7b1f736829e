"""Several runs of a search side by side: which repeat one another, and what tells others apart."""

import json
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from qdenv.run.config import WITHOUT_EFFECT, config_to_json
from qdenv.run.directory import RunDirectory
from qdenv.stats import margin, sample_of
from qdenv.types import InputError

# Runs that differ in these repeat one another.
_CHANCE = ("seed", *WITHOUT_EFFECT)
_WHO, _WHERE = "algorithm", "evaluation.domain"
_NAMES = {
    "map-elites": "MAP-Elites",
    "random": "random search",
    "cma-mae-screened": "CMA-MAE, screened",
}
# Columns of metrics.csv, and what people call them.
CURVES = {"qd_score": "QD-score", "coverage": "coverage", "best_objective": "best objective"}


class Group(NamedTuple):
    """Runs that differ in chance alone."""

    label: str  # the settings that differ from those of other groups
    runs: tuple[RunDirectory, ...]  # one or more
    evaluations: np.ndarray  # int [n], up to where all of them came
    curves: Mapping[str, np.ndarray]  # float [runs, n] each: what their metrics were then, by name

    @property
    def title(self) -> str:
        """Label and seeds."""
        seeds = ", ".join(str(run.config.seed) for run in self.runs)
        word = "seed" if len(self.runs) == 1 else "seeds"
        return f"{self.label} ({word} {seeds})"


def band_of(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Average curves (float [runs, n]) over runs.

    Return the mean (float [n]) and half its 95 % interval (Student's t; NaN for one run).
    """
    samples = [sample_of(column) for column in np.asarray(values).T]
    return np.array([one.mean for one in samples]), np.array([margin(one) for one in samples])


def group_runs(runs: Sequence[RunDirectory]) -> list[Group]:
    """Put runs of the same settings together, in the order of their first ones.

    Raises InputError if a run has no finished iteration, or two are of different objectives, which
    no scale shows side by side.
    """
    objectives = {run.schema.objective: run for run in runs}
    if len(objectives) > 1:
        one, other, *_ = objectives.values()
        both = f"{one} and {other} have different objectives, {' and '.join(objectives)}"
        raise InputError(f"{both}: no scale shows both, draw them one by one")
    from flax.traverse_util import flatten_dict  # imports jax

    kinds: dict[str, list[RunDirectory]] = {}
    for run in runs:
        every = flatten_dict(config_to_json(run.config), sep=".")
        settings = {k: v for k, v in every.items() if k.rpartition(".")[2] not in _CHANCE}
        kinds.setdefault(json.dumps(settings, sort_keys=True), []).append(run)
    labels = tell_apart([json.loads(kind) for kind in kinds])
    return [_group(label, group) for label, group in zip(labels, kinds.values(), strict=True)]


def tell_apart(settings: Sequence[Mapping[str, Any]]) -> list[str]:
    """Label configurations (settings by dotted names) by what differs.

    That is the algorithm or domain, then single settings.
    """
    names = list(dict.fromkeys(name for one in settings for name in one))
    differing = [
        name
        for name in names
        if not name.endswith(".name")
        and len({json.dumps(one[name]) for one in settings if name in one}) > 1
    ]
    chosen = {part: {one[f"{part}.name"] for one in settings} for part in (_WHERE, _WHO)}
    several = [part for part, found in chosen.items() if len(found) > 1]
    # Other algorithms and domains have other settings: their name is enough.
    shown = [name for name in differing if not any(name.startswith(f"{p}.") for p in several)]
    labels = [_label(one, several, shown) for one in settings]
    if len(set(labels)) < len(labels):
        labels = [_label(one, several, differing) for one in settings]
    return labels


def _label(one: Mapping[str, Any], several: Sequence[str], shown: Sequence[str]) -> str:
    parts = [one[f"{_WHERE}.name"]] * (_WHERE in several)
    parts += [algorithm_name(one[f"{_WHO}.name"])] * (_WHO in several or not (parts or shown))
    for name in shown:
        if name in one:
            value = f"{one[name]:g}" if isinstance(one[name], float) else one[name]
            parts.append(f"{name.rpartition('.')[2].replace('_', ' ')} {value}")
    return ", ".join(parts)


def algorithm_name(name: str) -> str:
    """Write an algorithm's name as papers do."""
    return _NAMES.get(name, name.upper() if name.startswith(("cma-", "dsage")) else name)


def _group(label: str, runs: Sequence[RunDirectory]) -> Group:
    """Read the curves of runs at the evaluations of the shortest one."""
    metrics = [run.read_progress() for run in runs]
    shortest = min(metrics, key=lambda rows: rows[-1].evaluations)
    evaluations = np.array([row.evaluations for row in shortest])
    # Of each run the last row that it had written by then: batches may differ.
    written = []
    for rows in metrics:
        last = np.searchsorted([row.evaluations for row in rows], evaluations, side="right") - 1
        written.append([rows[index] for index in np.maximum(last, 0)])
    curves = {
        name: np.array([[getattr(row, name) for row in rows] for rows in written])
        for name in CURVES
    }
    return Group(label, tuple(runs), evaluations, curves)
