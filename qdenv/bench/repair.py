"""Benchmark of the repair: published layouts, random generators, hard layouts, whole batches."""

import json
import resource
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import jax
import numpy as np
import tyro

from qdenv.domains import find_domain
from qdenv.files import write_atomically
from qdenv.formats.layouts import read_layout
from qdenv.generate.decode import choose_tiles
from qdenv.generate.nca import grow_population, make_generator, seed_canvas
from qdenv.repair.audit import audit
from qdenv.repair.pool import RepairPool
from qdenv.repair.recipe import RepairConfig, repair
from qdenv.types import RepairStatus, Rules

DOMAINS = ("warehouse-even", "manufacturing")
SIZE, SHELVES = (33, 36), 240
EVAL_SIZE, EVAL_SHELVES = (101, 102), 2500
PUBLISHED = Path(__file__).parents[3] / "shared" / "reference" / "layouts"
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


def run(
    polish: tuple[str, ...] = ("quick", "full"),
    random: int = 20,
    kernel_sizes: tuple[int, ...] = (3, 3, 3),
    hard: int = 1000,
    population: int = 50,
    eval_size: bool = True,
    seeds: int = 2,
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
) -> dict[str, Any]:
    """Repair and audit everything; CPU seconds, Hamming distances, bounds, failures.

    Args:
        polish: levels to measure.
        random: random generators per domain, weights from N(0, 0.2^2).
        kernel_sizes: of the random generators.
        hard: noise, stripes, pockets and one-tile layouts per domain, annealed and audited.
        population: layouts repaired in one call, 0 for none.
        eval_size: the published layouts of size S_eval as well, quick, and manufacturing full.
        seeds: repairs of each layout.
        json_file: where to write the result.
    """
    warm_up()
    result: dict[str, Any] = {"layouts": []}
    for name, kind, layout in layouts_at_size(random, kernel_sizes):
        for level in polish:
            row = measure(name, layout, rules_at_size(kind), RepairConfig(level), seeds)
            result["layouts"].append(row)
    result["summary"] = [summarise(result["layouts"], level) for level in polish]
    if eval_size:
        result["eval_size"] = list(measure_eval_size(polish))
    if population:
        result["population"] = [measure_population(kind, population) for kind in DOMAINS]
    if hard:
        result["hard"] = [count_failures(kind, hard) for kind in DOMAINS]
    result["peak_megabytes"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
    if json_file:
        write_atomically(json_file, (json.dumps(result, indent=1) + "\n").encode())
    for section in ("summary", "population", "hard", "peak_megabytes"):
        print(section, result.get(section))
    return result


def warm_up() -> None:
    """Compile the kernels, so that no measurement pays for it."""
    repair(np.zeros((3, 6), np.int8), find_domain(DOMAINS[0]).rules(3, 6, 0))


def rules_at_size(kind: str) -> Rules:
    """State the rules of a domain at size S."""
    return find_domain(kind).rules(*SIZE, SHELVES)


def layouts_at_size(
    random: int, kernel_sizes: tuple[int, ...]
) -> Iterator[tuple[str, str, np.ndarray]]:
    """List (name, domain, int8 [H, W]): published, one-tile and randomly grown layouts."""
    for path in sorted(PUBLISHED.glob("*_nca_a5_unrepaired.json")):
        kind = DOMAINS[path.name.startswith("manufacturing")]
        yield path.stem, kind, read_layout(path, find_domain(kind).tiles)
    for kind in DOMAINS:
        domain = find_domain(kind)
        for tile in (".", "@", "e", "0"):
            if tile in domain.generated:
                inside = np.full(inner_shape(kind), domain.tiles.index(tile), np.int8)
                name = f"{kind.removesuffix('-even')} all {tile!r}"
                yield name, kind, np.asarray(domain.frame(inside))
        for index, layout in enumerate(grow_random(kind, random, kernel_sizes)):
            yield f"{kind} random {index}", kind, layout


def inner_shape(kind: str) -> tuple[int, int]:
    """Size of the generated area of a domain at size S."""
    margin = find_domain(kind).margin
    return SIZE[0] - 2 * margin[0], SIZE[1] - 2 * margin[1]


def grow_random(kind: str, count: int, kernel_sizes: tuple[int, ...], seed: int = 0) -> np.ndarray:
    """Grow layouts (int8 [count, H, W]) from generators with N(0, 0.2^2) weights."""
    domain = find_domain(kind)
    generator = make_generator(len(domain.generated), kernel_sizes)
    start = seed_canvas(domain.seed_block, *inner_shape(kind), domain.generated)
    weights = 0.2 * jax.random.normal(jax.random.key(seed), (count, generator.size))
    cells = jax.jit(grow_population, static_argnums=(0, 3))(generator, weights, start, 50)
    return np.asarray(jax.vmap(domain.frame)(choose_tiles(cells)))


def measure(
    name: str, layout: np.ndarray, rules: Rules, config: RepairConfig, seeds: int
) -> dict[str, Any]:
    """Repair one layout from several seeds; every result is audited."""
    records = [repair(layout, rules, seed, config) for seed in range(seeds)]
    row = {
        "layout": name,
        "polish": config.polish,
        "hamming": [float(record.cost) for record in records],
        "lower_bound": max(float(record.lower_bound) for record in records),
        "status": [RepairStatus(int(record.status)).name for record in records],
        "cpu_seconds": [round(float(record.seconds), 2) for record in records],
        "broken": sum(len(audit(record.layout, rules)) for record in records),
        "before": BEFORE.get(name),
    }
    print(*row.values(), flush=True)
    return row


def summarise(rows: list[dict[str, Any]], polish: str) -> dict[str, Any]:
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


def measure_eval_size(polish: tuple[str, ...]) -> Iterator[dict[str, Any]]:
    """Repair the published layouts of size S_eval."""
    for path in sorted(PUBLISHED.glob("*_eval_unrepaired.json")):
        kind = DOMAINS[path.name.startswith("manufacturing")]
        rules = find_domain(kind).rules(*EVAL_SIZE, EVAL_SHELVES)
        layout = read_layout(path, rules.tiles)
        for level in polish:
            yield measure(path.stem, layout, rules, RepairConfig(level), 1)


def measure_population(kind: str, count: int) -> dict[str, Any]:
    """Repair a randomly grown population in one call."""
    layouts = grow_random(kind, count, (3, 3, 3), seed=1)
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


def hard_layouts(kind: str, count: int, seed: int = 0) -> Iterator[np.ndarray]:
    """Draw layouts (int8 [H, W]) that are far from any rule: noise, stripes, pockets, one tile."""
    domain, rng = find_domain(kind), np.random.default_rng(seed)
    (height, width), kinds = inner_shape(kind), len(domain.generated)
    rows, cols = np.indices((height, width))
    for index in range(count):
        first, second = rng.choice(kinds, 2, replace=False)
        period, slope = rng.integers(2, 7), rng.integers(-2, 3)
        if index % 4 == 0:  # noise of any mixture
            inside = rng.choice(kinds, (height, width), p=rng.dirichlet(np.ones(kinds)))
        elif index % 4 == 1:  # stripes at any angle
            along = (rows + slope * cols) if rng.integers(2) else cols
            inside = np.where(along % period < rng.integers(1, period), first, second)
        elif index % 4 == 2:  # pockets: every cell of a lattice is walled in
            walls = (rows % period == 0) | (cols % period == 0)
            inside = np.where(walls, first, second)
        else:  # one tile with specks of another
            specks = rng.random((height, width)) < rng.choice([0.0, 0.001, 0.01, 0.1])
            inside = np.where(specks, second, first)
        yield np.asarray(domain.frame(inside.astype(np.int8)))


def count_failures(kind: str, count: int) -> dict[str, Any]:
    """Anneal and audit hard layouts, with a third of the usual moves.

    Without the solver: it only ever starts from a feasible layout.
    """
    config = RepairConfig("none", moves_per_cell=200)
    rules, seconds, failed, broken = rules_at_size(kind), [], 0, 0
    for layout in hard_layouts(kind, count):
        record = repair(layout, rules, 0, config)
        failed += int(record.status >= RepairStatus.IMPOSSIBLE)
        broken += bool(audit(record.layout, rules))
        seconds.append(float(record.seconds))
    return {
        "domain": kind,
        "layouts": count,
        "failed": failed,
        "broken": broken,
        "cpu_seconds_median": round(float(np.median(seconds)), 3),
        "cpu_seconds_max": round(float(np.max(seconds)), 3),
    }
