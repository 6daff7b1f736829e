"""Benchmark of the repair: one-tile, grown and hard layouts, whole batches, files of your own."""

import resource
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from experiments.benchmarks.layouts import (
    DOMAINS,
    EVAL_SIZE,
    FLEETS,
    KERNELS,
    SIZE,
    Case,
    grow_large,
    grow_random,
    hard_layouts,
    layouts_at_size,
    mutated_tiles,
    random_tiles,
    read_unrepaired,
    rules_at_size,
)
from qdenv.io.files import write_json
from qdenv.repair.audit import audit
from qdenv.repair.pool import RepairPool
from qdenv.repair.recipe import repair_layout
from qdenv.repair.settings import Polish, RepairConfig
from qdenv.types import RepairStatus, Rules

SMALL = (17, 16)  # of the preset `quick`
# Changed tiles of earlier measurements: annealing with 3e6 moves in C++, then HiGHS for 2.5 s.
BEFORE = {
    "warehouse_even_nca_a5_unrepaired": 32,
    "warehouse_uneven_nca_a5_unrepaired": 147,
    "manufacturing_nca_a5_unrepaired": 147,
    "warehouse_eval_unrepaired": 1266,
    "manufacturing_eval_unrepaired": 1716,
    "warehouse all '.'": 325,
    "warehouse all 'e'": 241,
    "warehouse all '@'": 816,
    "manufacturing all '0'": 417,
    "manufacturing all 'e'": 262,
}


@dataclass(frozen=True)
class Options:
    """What to repair, and how often."""

    # unrepaired layout files to measure as well, of size S or larger
    layouts: tuple[Path, ...] = ()
    polish: tuple[Polish, ...] = ("quick", "full")  # levels to measure
    random: int = 20  # random generators per domain, weights from N(0, 0.2^2)
    kernel_sizes: tuple[int, ...] = KERNELS  # of the random generators
    # noise, stripes, pockets and one-tile layouts per domain, annealed and audited
    hard: int = 1000
    population: int = 50  # layouts repaired in one call, 0 for none
    # random tile maps per domain and size, and mutations of them, as a search of tiles asks for; a
    # tenth of them at S_eval
    tiles: int = 50
    # layouts of size S_eval as well: the given ones, else one grown per domain
    eval_size: bool = True
    seeds: int = 2  # repairs of each layout


def run(
    options: Annotated[Options, tyro.conf.arg(name="")],
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
) -> dict[str, Any]:
    """Repair and audit everything; CPU seconds, Hamming distances, bounds, failures.

    Args:
        options: what to repair, and how often.
        json_file: where to write the result.
    """
    warm_up()
    given = [read_unrepaired(path) for path in options.layouts]
    if not given:
        print("no --layouts given: hand-made and grown layouts only")
    small = [case for case in given if case.layout.shape == SIZE]
    large = [case for case in given if case.layout.shape != SIZE]
    result: dict[str, Any] = {"layouts": []}
    for case in (*small, *layouts_at_size(options.random, options.kernel_sizes)):
        for level in options.polish:
            result["layouts"].append(measure(case, RepairConfig(level), options.seeds))
    result["summary"] = [summarise(result["layouts"], level) for level in options.polish]
    if options.eval_size:
        cases = large or [grow_large(kind) for kind in DOMAINS]
        result["eval_size"] = [
            measure(case, RepairConfig(level), 1) for case in cases for level in options.polish
        ]
    elif large:
        print(f"left out without --eval-size: {', '.join(case.name for case in large)}")
    if options.population:
        result["population"] = [measure_population(kind, options.population) for kind in DOMAINS]
    if options.hard:
        result["hard"] = [count_failures(kind, options.hard) for kind in DOMAINS]
    if options.tiles:
        shapes = (SMALL, SIZE, EVAL_SIZE) if options.eval_size else (SMALL, SIZE)
        result["tiles"] = [
            row
            for shape in shapes
            for kind in FLEETS
            for row in compare_tiles(kind, shape, options.tiles)
        ]
    result["peak_megabytes"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
    if json_file:
        write_json(json_file, result)
    for section in ("summary", "population", "tiles", "hard", "peak_megabytes"):
        print(section, result.get(section))
    return result


def warm_up() -> None:
    """Compile the kernels, so that no measurement pays for it."""
    repair_layout(np.zeros((3, 6), np.int8), rules_at_size(DOMAINS[0], (3, 6)))


def measure(case: Case, config: RepairConfig, seeds: int) -> dict[str, Any]:
    """Repair one layout from several seeds; every result is audited."""
    shape = case.layout.shape[0], case.layout.shape[1]
    rules = rules_at_size(case.kind, shape)
    records = [repair_layout(case.layout, rules, seed, config) for seed in range(seeds)]
    row = {
        "layout": case.name,
        "polish": config.polish,
        "hamming": [float(record.cost) for record in records],
        "lower_bound": max(float(record.lower_bound) for record in records),
        "status": [RepairStatus(int(record.status)).name for record in records],
        "cpu_seconds": [round(float(record.seconds), 2) for record in records],
        "broken": sum(len(audit(np.asarray(record.layout), rules)) for record in records),
        "before": BEFORE.get(case.name),
    }
    print(*row.values(), flush=True)
    return row


def summarise(rows: Sequence[dict[str, Any]], polish: str) -> dict[str, Any]:
    """Put all layouts of one level into a few numbers."""
    mine = [row for row in rows if row["polish"] == polish]
    seconds = np.concatenate([row["cpu_seconds"] for row in mine])
    known = [row for row in mine if row["before"]]
    excess = [np.mean(row["hamming"]) / row["before"] - 1 for row in known]
    return {
        "polish": polish,
        "repairs": len(seconds),
        "broken": sum(row["broken"] for row in mine),
        "cpu_seconds_median": float(np.median(seconds)),
        "cpu_seconds_max": float(seconds.max()),
        "mean_hamming": float(np.mean([row["hamming"] for row in mine])),
        "mean_excess_over_before": float(np.mean(excess)) if known else None,
        "proven_optimal": sum(row["status"].count("OPTIMAL") for row in mine),
    }


def measure_population(kind: str, count: int) -> dict[str, Any]:
    """Repair a randomly grown population in one call."""
    layouts = grow_random(kind, count, seed=1)
    with RepairPool(rules_at_size(kind)) as pool:
        cpu, wall = time.process_time(), time.perf_counter()
        records = pool.repair(layouts)
        cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    return {
        "domain": kind,
        "layouts": count,
        "workers": pool.workers,
        "cpu_seconds": round(cpu, 2),
        "wall_seconds": round(wall, 2),
        "failed": int((records.status >= RepairStatus.IMPOSSIBLE).sum()),
    }


def compare_tiles(kind: str, shape: tuple[int, int], count: int) -> list[dict[str, Any]]:
    """Repair tile maps as a search of tiles draws them, beside as many grown ones."""
    if shape == EVAL_SIZE:
        count = -(-count // 10)
    rules = rules_at_size(kind, shape)
    drawn, row = random_tiles(kind, count, shape=shape), {"domain": kind, "shape": shape}
    grown, _ = repair_all(grow_random(kind, count, shape=shape), rules)
    first, repaired = repair_all(drawn, rules)
    again, _ = repair_all(mutated_tiles(kind, repaired), rules)
    named = {"grown": grown, "random tiles": first, "mutated repaired tiles": again}
    rows = [{**row, "layouts": name, **numbers} for name, numbers in named.items()]
    for numbers in rows:
        print(*numbers.values(), flush=True)
    return rows


def repair_all(layouts: np.ndarray, rules: Rules) -> tuple[dict[str, Any], np.ndarray]:
    """Repair layouts (int8 [B, H, W]) one by one; returns the figures and the repaired layouts."""
    records = [repair_layout(layout, rules) for layout in layouts]
    repaired = np.stack([record.layout for record in records])
    cost, seconds = (
        np.array([getattr(record, name) for record in records], float)
        for name in ("cost", "seconds")
    )
    figures = {
        "count": len(records),
        "feasible": sum(not audit(layout, rules) for layout in repaired),
        "hamming_mean": round(float(cost.mean()), 1),
        "hamming_max": float(cost.max()),
        "lower_bound_mean": round(float(np.mean([record.lower_bound for record in records])), 1),
        "cpu_seconds_mean": round(float(seconds.mean()), 3),
        "cpu_seconds_max": round(float(seconds.max()), 3),
    }
    return figures, repaired


def count_failures(kind: str, count: int) -> dict[str, Any]:
    """Anneal and audit hard layouts, with a seventh of the moves of a search.

    Without the solver, which only ever starts from a feasible layout.
    """
    config = RepairConfig("none", moves_per_cell=200)
    rules, seconds, failed, broken = rules_at_size(kind), [], 0, 0
    for layout in hard_layouts(kind, count):
        record = repair_layout(layout, rules, 0, config)
        failed += int(record.status >= RepairStatus.IMPOSSIBLE)
        broken += bool(audit(np.asarray(record.layout), rules))
        seconds.append(float(record.seconds))
    return {
        "domain": kind,
        "layouts": count,
        "failed": failed,
        "broken": broken,
        "cpu_seconds_median": round(float(np.median(seconds)), 3),
        "cpu_seconds_max": round(float(np.max(seconds)), 3),
    }
