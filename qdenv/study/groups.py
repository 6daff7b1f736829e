"""Several runs of a search side by side: which repeat one another, and what tells others apart."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from qdenv.run.config import RunConfig, config_to_json
from qdenv.run.directory import RunDirectory
from qdenv.stats import margin, sample_of
from qdenv.types import InputError

_CHANCE = (
    "seed",
    "evaluations",
    "checkpoint_every",
)  # runs that differ in these repeat one another
WHO, WHERE = "algorithm", "evaluation.domain"
_WORDS = {
    "map-elites": "MAP-Elites",
    "random": "random search",
    "cma-mae-screened": "CMA-MAE, screened",
}
_INITIALS = ("cma-", "dsage")  # names that are written in capitals
# Columns of metrics.csv, and how people call them.
CURVES = {"qd_score": "QD-score", "coverage": "coverage", "best_objective": "best objective"}


class Group(NamedTuple):
    """Runs that differ in chance alone."""

    label: str  # what tells them from other groups, in words
    runs: tuple[RunDirectory, ...]  # one or more
    evaluations: np.ndarray  # int [n], up to where all of them came
    curves: Mapping[str, np.ndarray]  # float [runs, n] each: what their metrics were then, by name

    @property
    def title(self) -> str:
        """Say what they are, and how many."""
        seeds = ", ".join(str(run.config.seed) for run in self.runs)
        word = "seed" if len(self.runs) == 1 else "seeds"
        return f"{self.label} ({word} {seeds})"


class Band(NamedTuple):
    """The mean of a curve over runs."""

    mean: np.ndarray  # float [n]
    # float [n], half the width of its 95 % interval (Student's t); NaN for one run
    half: np.ndarray


def band_of(values: np.ndarray) -> Band:
    """Average curves (float [runs, n]) with their interval."""
    samples = [sample_of(column) for column in np.asarray(values).T]
    means, halves = [one.mean for one in samples], [margin(one) for one in samples]
    return Band(np.array(means), np.array(halves))


def group_runs(runs: Sequence[RunDirectory]) -> list[Group]:
    """Put runs of the same settings together, in the order of their first ones.

    Raises:
        InputError: a run has no finished iteration, or two are of different objectives, which no
            scale shows side by side.
    """
    objectives = {run.schema.objective: run for run in runs}
    if len(objectives) > 1:
        one, other, *_ = objectives.values()
        raise InputError(
            f"{one} and {other} have different objectives, {' and '.join(objectives)}: "
            "no scale shows both, draw them one by one"
        )
    kinds: dict[str, list[RunDirectory]] = {}
    for run in runs:
        kinds.setdefault(json.dumps(_settings(run.config), sort_keys=True), []).append(run)
    labels = tell_apart([json.loads(kind) for kind in kinds])
    return [_group(label, group) for label, group in zip(labels, kinds.values(), strict=True)]


def _settings(config: RunConfig) -> dict[str, Any]:
    """List what decides a run apart from chance and length, by dotted names."""
    flat: dict[str, Any] = {}

    def walk(way: str, value: Any) -> None:
        if isinstance(value, Mapping):
            for name, inner in value.items():
                walk(f"{way}.{name}" if way else name, inner)
        else:
            flat[way] = value

    walk("", {k: v for k, v in config_to_json(config).items() if k not in _CHANCE})
    return flat


def tell_apart(settings: Sequence[Mapping[str, Any]]) -> list[str]:
    """Name each of some configurations by what differs: who searches where, then single settings.

    Args:
        settings: by dotted names.
    """
    names = list(dict.fromkeys(name for one in settings for name in one))
    differing = [
        name
        for name in names
        if not name.endswith(".name")
        and len({json.dumps(one[name]) for one in settings if name in one}) > 1
    ]
    said = {room: {one[f"{room}.name"] for one in settings} for room in (WHERE, WHO)}
    # Other algorithms and domains have other settings: their name says it all.
    implied = [room for room, found in said.items() if len(found) > 1]
    told = [name for name in differing if not any(name.startswith(f"{room}.") for room in implied)]
    labels = [_label(one, said, told) for one in settings]
    if len(set(labels)) < len(labels):
        labels = [_label(one, said, differing) for one in settings]
    return labels


def _label(one: Mapping[str, Any], said: Mapping[str, set[str]], told: Sequence[str]) -> str:
    words = [one[f"{WHERE}.name"]] * (len(said[WHERE]) > 1)
    words += [algorithm_name(one[f"{WHO}.name"])] * (len(said[WHO]) > 1 or not (words or told))
    for name in told:
        if name in one:
            words.append(f"{name.rpartition('.')[2].replace('_', ' ')} {_value(one[name])}")
    return ", ".join(words)


def _value(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def algorithm_name(name: str) -> str:
    """Write an algorithm's name as papers do."""
    return _WORDS.get(name, name.upper() if name.startswith(_INITIALS) else name)


def _group(label: str, runs: Sequence[RunDirectory]) -> Group:
    metrics = [run.read_metrics() for run in runs]
    for run, rows in zip(runs, metrics, strict=True):
        if not rows:
            raise InputError(f"{run}: nothing is done yet; `qdenv resume {run}` begins")
    shortest = min(metrics, key=lambda rows: rows[-1].evaluations)
    evaluations = np.array([row.evaluations for row in shortest])
    curves: dict[str, np.ndarray] = {}
    for name in CURVES:
        lines = []
        for rows in metrics:
            done = [row.evaluations for row in rows]
            last = np.searchsorted(done, evaluations, side="right") - 1
            lines.append(np.array([getattr(row, name) for row in rows])[np.maximum(last, 0)])
        curves[name] = np.stack(lines)
    return Group(label, tuple(runs), evaluations, curves)
