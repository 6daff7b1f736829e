"""What the explorer says of each elite in numbers: columns in people's words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from qdenv.domains.base import Domain
from qdenv.run.archive import Archive
from qdenv.score import wilson_interval
from qdenv.study.stats import Sample, margin

NUMBER, SHARE, WHOLE = "number", "share", "whole"
# Columns of an archive: what they are called, and how they are written.
WORDS = {
    "similarity": ("similarity before and after repair [0 to 1]", NUMBER),
    "throughput": ("throughput [tasks per timestep]", NUMBER),
    "waiting": ("time that robots wait", SHARE),
    "path_length": ("moves per task", NUMBER),
    "length": ("steps of the agent", NUMBER),
    "shortest": ("shortest path [steps]", NUMBER),
}
# Told in another way, or of no interest to whoever looks at layouts.
UNTOLD = {"index", "solution", "objective", "measures", "threshold", "status"}
UNTOLD |= {"repaired", "unrepaired", "congested", "success", "end_timestep"}
RUNS = ("throughput", "length")  # the first there is is shown run by run
ALIKE = 1e-4  # relative; columns that differ by less are told once


class Column(NamedTuple):
    """A number of each elite."""

    key: str  # a name for scripts
    label: str  # in words, with the unit
    form: str  # how it is written: a number, a share in per cent, or a whole number
    values: np.ndarray  # float32 [elites]; NaN where there is none


class Runs(NamedTuple):
    """What was counted in each simulation of each elite."""

    label: str  # in words, with the unit
    values: np.ndarray  # float32 [elites, S]
    # times the standard deviation: half of a 95 % interval of the mean; 0 for one run
    factor: float


def columns_of(archive: Archive, domain: Domain) -> list[Column]:
    """List what is known of each elite: its measures first, then what the map can show."""
    data, repairs = archive.columns, domain.rules is not None
    found = [
        Column(f"measure{number}", axis.name, NUMBER, data["measures"][:, number])
        for number, axis in enumerate(archive.meaning.measures)
    ]
    found.append(Column("objective", archive.meaning.objective, NUMBER, data["objective"]))
    if (success := success_of(data)) is not None:
        label = "runs without congestion" if "congested" in data else "runs that reach the goal"
        found.append(Column("success", label, SHARE, success.mean(axis=1)))
    if repairs and "unrepaired" in data:
        changed = (data["repaired"] != data["unrepaired"]).sum(axis=(1, 2))
        found.append(Column("changed", "cells changed by the repair", WHOLE, changed))
    others = set(data) - UNTOLD - (set() if repairs else {"similarity"})
    for name in sorted(others, key=[*WORDS, *sorted(others)].index):
        label, form = WORDS.get(name, (name.replace("_", " "), NUMBER))
        values = data[name].astype(np.float64).reshape(len(archive), -1).mean(axis=1)
        if data[name].ndim <= 2 and not any(
            np.allclose(values, one.values, ALIKE) for one in found
        ):
            found.append(Column(name, label, form, values))
    return [one._replace(values=finite(one.values)) for one in found]


def finite(values: np.ndarray) -> np.ndarray:
    """Turn numbers into single precision, and what is none into NaN."""
    return np.where(np.isfinite(values), values, np.nan).astype("<f4")


def success_of(columns: Mapping[str, np.ndarray]) -> np.ndarray | None:
    """Tell which simulations went well, bool [elites, S]; None where nobody counted."""
    if "congested" in columns:
        return ~columns["congested"].astype(bool)
    return columns["success"].astype(bool) if "success" in columns else None


def runs_of(columns: Mapping[str, np.ndarray]) -> Runs | None:
    """Find what is shown simulation by simulation; None where nothing was counted so."""
    name = next((name for name in RUNS if name in columns and columns[name].ndim == 2), None)
    if name is None:
        return None
    count = columns[name].shape[1]
    factor = margin(Sample(0.0, 1 / np.sqrt(count), count)) if count > 1 else 0.0
    return Runs(WORDS[name][0], finite(columns[name]), factor)


def colour_first(columns: list[Column]) -> int:
    """Choose what colours the map at first: the first that is not the same nearly everywhere."""
    shown = [number for number, one in enumerate(columns) if not one.key.startswith("measure")]
    ends = {number: np.nanquantile(columns[number].values, (0.02, 0.98)) for number in shown}
    return next((number for number, (low, high) in ends.items() if low < high), shown[0])


def facts_of_columns(archive: Archive, columns: list[Column], runs: Runs | None) -> dict[str, Any]:
    """Say what the packed numbers are, JSON-ready."""
    success = success_of(archive.columns)
    simulations = 0 if success is None else success.shape[1]
    return {
        "columns": [{"key": one.key, "label": one.label, "form": one.form} for one in columns],
        "colour": colour_first(columns),
        "runs": None
        if runs is None
        else {"label": runs.label, "count": runs.values.shape[1], "factor": runs.factor},
        # An interval of the rate for each number of runs that went well.
        "wilson": [wilson_interval(good, simulations) for good in range(simulations + 1)]
        if simulations
        else [],
    }
