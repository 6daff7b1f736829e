"""Benchmark of the repair, and the layouts that benchmarks and tests repair."""

from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path
from statistics import mean, median

import jax
import numpy as np

import qdenv
from experiments.benchmarks.common import Row, Stopwatch, save, show
from experiments.published import FLEETS
from qdenv.grid import inside_frame
from qdenv.ranges import PositiveInt
from qdenv.repairs.recipe import repair_layout
from qdenv.repairs.settings import Polish, RepairConfig
from qdenv.types import RepairStatus, Rules

SMALL, SIZE, EVAL_SIZE = (17, 16), (33, 36), (101, 102)  # of the preset `quick`, S, S_eval
DOMAINS = ("warehouse-even", "manufacturing")  # whose rules differ
KERNELS = (3, 3, 3)
Layouts = Sequence[np.ndarray] | np.ndarray  # int8 [B, H, W]
Group = tuple[str, str, Layouts]  # name and domain of layouts


def repair(
    layouts: tuple[Path, ...] = (),
    polish: tuple[Polish, ...] = ("quick", "full"),
    random: int = 20,
    kernel_sizes: tuple[int, ...] = KERNELS,
    hard: int = 1000,
    population: int = 50,
    tiles: int = 50,
    eval_size: bool = True,
    seeds: PositiveInt = 2,
    json: Path | None = None,
) -> Row:
    """Repair and audit files, layouts of one tile, of random automata and of random tiles.

    Args:
        layouts: unrepaired layout files.
        polish: levels to measure.
        random: number of random automata per domain.
        kernel_sizes: of these automata.
        hard: number of layouts of noise, stripes, pockets and one tile per domain, annealed only.
        population: number of layouts repaired in one call; 0 for none.
        tiles: number of random tile maps, and of mutations of them, per domain and size, as a
            search of tiles repairs; a tenth of them at S_eval.
        eval_size: also repair layouts of size S_eval.
        seeds: number of repairs of each layout of size S.
        json: file of the result.
    """
    sizes = (SMALL, SIZE, EVAL_SIZE) if eval_size else (SMALL, SIZE)
    repair_layout(np.zeros((3, 6), np.int8), rules_at_size(DOMAINS[0], (3, 6)))  # compiles

    def rows() -> Iterator[Row]:
        plans = map(qdenv.read_plan, layouts)
        groups: list[Group] = [(plan.name, plan.domain.name, [plan.layout]) for plan in plans]
        groups += one_tile_layouts()
        for kind in DOMAINS:
            if random:
                groups.append((f"{kind} random", kind, grow_random(kind, random, kernel_sizes)))
            if eval_size:
                groups.append((f"{kind} S_eval", kind, grow_random(kind, 1, shape=EVAL_SIZE)))
        for (name, kind, group), level in product(groups, polish):
            repeats = seeds if group[0].shape == SIZE else 1
            yield repair_all(name, kind, group, RepairConfig(level), repeats)[0]
        for kind in DOMAINS if hard else ():
            # A seventh of the moves of a search; the solver only starts from feasible layouts.
            config = RepairConfig("none", moves_per_cell=200)
            yield repair_all(f"{kind} hard", kind, hard_layouts(kind, hard), config)[0]
        for shape, kind in product(sizes if tiles else (), FLEETS):
            count = -(-tiles // 10) if shape == EVAL_SIZE else tiles
            name, quick = f"{kind} {shape[0]}x{shape[1]}", RepairConfig()
            drawn = grow_random(kind, count, shape=shape)
            yield repair_all(f"{name} automata", kind, drawn, quick)[0]
            drawn = random_tiles(kind, count, shape=shape)
            row, repaired = repair_all(f"{name} random tiles", kind, drawn, quick)
            yield row
            yield repair_all(f"{name} mutated", kind, mutated_tiles(kind, repaired), quick)[0]

    tables = {"repairs": show("repairs", rows())}
    if population:
        batches = (repair_population(kind, population) for kind in DOMAINS)
        tables["population"] = show("a population in one call", batches)
    return save(json, **tables)


def repair_all(
    name: str, kind: str, layouts: Layouts, config: RepairConfig, seeds: int = 1
) -> tuple[Row, np.ndarray]:
    """Repair layouts (int8 [B, H, W]) one by one: a row, and what the last seed repaired."""
    rules = rules_at_size(kind, layouts[0].shape)
    repairs = [
        repair_layout(layout, rules, seed, config) for seed in range(seeds) for layout in layouts
    ]
    repaired = [np.asarray(repair.layout) for repair in repairs]
    costs = [float(repair.cost) for repair in repairs]
    seconds = [float(repair.seconds) for repair in repairs]
    status = [int(repair.status) for repair in repairs]
    row = {
        "layouts": name,
        "polish": config.polish,
        "repairs": len(repairs),
        "failed": sum(number >= RepairStatus.IMPOSSIBLE for number in status),
        "broken": sum(bool(qdenv.audit(layout, rules)) for layout in repaired),
        "optimal": status.count(RepairStatus.OPTIMAL),
        "changed": mean(costs),
        "most_changed": max(costs),
        "lower_bound": mean(float(repair.lower_bound) for repair in repairs),
        "cpu_s": median(seconds),
        "most_cpu_s": max(seconds),
        "changed_each": costs,
    }
    return row, np.stack(repaired[-len(layouts) :])


def repair_population(kind: str, count: int) -> Row:
    """Repair a population of random automata's layouts in one call, on all cores."""
    layouts = grow_random(kind, count, seed=1)
    pool = qdenv.make_pipeline(qdenv.EvaluationConfig(qdenv.find_domain(kind).config)).pool
    assert pool is not None
    with pool, Stopwatch() as watch:
        repairs = pool.repair(layouts)
    failed = int((repairs.status >= RepairStatus.IMPOSSIBLE).sum())
    row = {"domain": kind, "layouts": count, "workers": pool.workers, "failed": failed}
    return row | watch.per(count)


def rules_at_size(kind: str, shape: tuple[int, int] = SIZE) -> Rules:
    """Return the rules of a domain at one size."""
    rules = qdenv.find_domain(kind).resized(*shape).rules
    assert rules is not None
    return rules()


def one_tile_layouts() -> Iterator[Group]:
    """Yield layouts of size S whose generated area holds a single kind of tile."""
    for kind, tile in product(DOMAINS, ".@e0"):
        domain = qdenv.find_domain(kind)
        if tile in domain.generated:
            inside = np.full(domain.generated_shape, domain.tiles.index(tile), np.int8)
            yield f"{kind} all {tile!r}", kind, [np.asarray(domain.frame(inside))]


def grow_random(
    kind: str,
    count: int,
    kernel_sizes: tuple[int, ...] = KERNELS,
    seed: int = 0,
    shape: tuple[int, int] = SIZE,
) -> np.ndarray:
    """Grow layouts (int8 [count, H, W]) of automata with N(0, 0.2^2) weights."""
    domain = qdenv.find_domain(kind).resized(*shape)
    # Cells grow out of a seed, one per step: a larger canvas needs as many more.
    generator = qdenv.NcaConfig(round(50 * shape[0] / SIZE[0]), kernel_sizes)
    pipeline = qdenv.make_pipeline(qdenv.EvaluationConfig(domain.config, generator))
    weights = 0.2 * jax.random.normal(jax.random.key(seed), (count, pipeline.solution_size))
    return np.asarray(jax.jit(pipeline.grow)(weights))


def random_tiles(kind: str, count: int, seed: int = 0, shape: tuple[int, int] = SIZE) -> np.ndarray:
    """Draw every generated tile uniformly (int8 [count, H, W]), as a search of tiles starts."""
    domain, rng = qdenv.find_domain(kind).resized(*shape), np.random.default_rng(seed)
    inside = rng.integers(len(domain.generated), size=(count, *domain.generated_shape))
    return np.stack([domain.frame(one) for one in inside.astype(np.int8)])


def mutated_tiles(kind: str, layouts: np.ndarray, seed: int = 0) -> np.ndarray:
    """Mutate one to ten tiles of each layout (int8 [count, H, W]), as a search of tiles does."""
    domain = qdenv.find_domain(kind).resized(*layouts.shape[1:])
    rng, mutated = np.random.default_rng(seed), layouts.copy()
    for layout in mutated:
        inside = inside_frame(layout, domain.margin)  # a view
        cells = rng.choice(inside.size, rng.integers(1, 11), replace=False)
        tiles = rng.integers(len(domain.generated), size=cells.size)
        inside[np.unravel_index(cells, inside.shape)] = tiles
    return mutated


def hard_layouts(kind: str, count: int, seed: int = 0) -> list[np.ndarray]:
    """Draw layouts (int8 [H, W]) far from all rules: noise, stripes, pockets, one tile."""
    domain, rng = qdenv.find_domain(kind), np.random.default_rng(seed)
    shape, kinds = domain.generated_shape, len(domain.generated)
    rows, cols = np.indices(shape)
    layouts = []
    for index in range(count):
        first, second = rng.choice(kinds, 2, replace=False)
        period, slope = rng.integers(2, 7), rng.integers(-2, 3)
        if index % 4 == 0:  # noise of any mixture
            inside = rng.choice(kinds, shape, p=rng.dirichlet(np.ones(kinds)))
        elif index % 4 == 1:  # stripes at any angle
            along = (rows + slope * cols) if rng.integers(2) else cols
            inside = np.where(along % period < rng.integers(1, period), first, second)
        elif index % 4 == 2:  # pockets: every cell of a lattice is walled in
            inside = np.where((rows % period == 0) | (cols % period == 0), first, second)
        else:  # one tile with specks of another
            specks = rng.random(shape) < rng.choice([0.0, 0.001, 0.01, 0.1])
            inside = np.where(specks, second, first)
        layouts.append(np.asarray(domain.frame(inside.astype(np.int8))))
    return layouts
