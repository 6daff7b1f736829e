"""Layouts to repair in benchmarks and tests: grown at random, of one tile, hard, or read."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np

from qdenv.domains.base import find_domain
from qdenv.generate import GENERATORS, inside_frame
from qdenv.io.layouts import read_layout
from qdenv.nca import NcaConfig
from qdenv.pipeline import canvas_of
from qdenv.types import InputError, Rules

SIZE, EVAL_SIZE = (33, 36), (101, 102)  # S and S_eval
FLEETS = ("warehouse-even", "warehouse-uneven", "manufacturing")
DOMAINS = ("warehouse-even", "manufacturing")  # whose rules differ
KERNELS = (3, 3, 3)
MUTATED = 10  # cells drawn anew by one mutation, at most


class Case(NamedTuple):
    """One layout to repair."""

    name: str  # of its row
    kind: str  # name of the domain
    layout: np.ndarray  # int8 [H, W], unrepaired


def read_unrepaired(path: Path) -> Case:
    """Read a layout of whichever domain knows all its tiles.

    Raises:
        InputError: no domain of the benchmark knows them, or the size is neither S nor S_eval.
    """
    reasons = []
    for kind in DOMAINS:
        try:
            layout = read_layout(path, find_domain(kind).tiles)
        except InputError as error:
            reasons.append(str(error))
            continue
        if layout.shape not in (SIZE, EVAL_SIZE):
            rows, cols = layout.shape
            raise InputError(f"{path}: {rows} x {cols}, give layouts of {SIZE} or {EVAL_SIZE}")
        return Case(path.stem, kind, layout)
    raise InputError(f"{path}: of no domain measured here ({'; '.join(reasons)})")


def rules_at_size(kind: str, shape: tuple[int, int] = SIZE) -> Rules:
    """State the rules of a domain at one size.

    Raises:
        InputError: nothing is repaired in this domain.
    """
    domain = find_domain(kind).resized(*shape)
    if domain.rules is None:
        raise InputError(f"nothing is repaired in {kind}: choose another domain")
    return domain.rules()


def layouts_at_size(random: int, kernel_sizes: tuple[int, ...]) -> Iterator[Case]:
    """List layouts of size S: of one tile, and randomly grown."""
    for kind in DOMAINS:
        domain = find_domain(kind)
        for tile in (".", "@", "e", "0"):
            if tile in domain.generated:
                inside = np.full(domain.generated_shape, domain.tiles.index(tile), np.int8)
                name = f"{kind.removesuffix('-even')} all {tile!r}"
                yield Case(name, kind, np.asarray(domain.frame(inside)))
        for index, layout in enumerate(grow_random(kind, random, kernel_sizes)):
            yield Case(f"{kind} random {index}", kind, layout)


def grow_random(
    kind: str,
    count: int,
    kernel_sizes: tuple[int, ...] = KERNELS,
    seed: int = 0,
    shape: tuple[int, int] = SIZE,
) -> np.ndarray:
    """Grow layouts (int8 [count, H, W]) from generators with N(0, 0.2^2) weights."""
    domain = find_domain(kind).resized(*shape)
    # A drawing spreads a cell per step: the larger canvas needs as many more steps (section E.3).
    steps = round(50 * shape[0] / SIZE[0])
    generator = GENERATORS.make(NcaConfig(steps, kernel_sizes), canvas_of(domain))
    weights = 0.2 * jax.random.normal(jax.random.key(seed), (count, generator.size))
    grow = jax.jit(lambda weights: jax.vmap(domain.frame)(generator.grow(weights, steps)))
    return np.asarray(grow(weights))


def grow_large(kind: str) -> Case:
    """Grow one layout of size S_eval from a fixed key."""
    (layout,) = grow_random(kind, 1, shape=EVAL_SIZE)
    return Case(f"{kind} random 0 of S_eval", kind, layout)


def random_tiles(kind: str, count: int, seed: int = 0, shape: tuple[int, int] = SIZE) -> np.ndarray:
    """Draw every generated tile uniformly (int8 [count, H, W]): where a search of tiles begins."""
    domain, rng = find_domain(kind).resized(*shape), np.random.default_rng(seed)
    inside = rng.integers(len(domain.generated), size=(count, *domain.generated_shape))
    return np.stack([np.asarray(domain.frame(tiles)) for tiles in inside.astype(np.int8)])


def mutated_tiles(kind: str, layouts: np.ndarray, seed: int = 0) -> np.ndarray:
    """Draw one to ten tiles of each layout (int8 [count, H, W]) anew, as a search of tiles does."""
    domain = find_domain(kind).resized(layouts.shape[1], layouts.shape[2])
    rng, mutated = np.random.default_rng(seed), layouts.copy()
    for layout in mutated:
        inside = inside_frame(layout, domain.margin)
        cells = rng.choice(inside.size, rng.integers(1, MUTATED + 1), replace=False)
        inside[np.unravel_index(cells, inside.shape)] = rng.integers(
            len(domain.generated), size=cells.size
        )
    return mutated


def hard_layouts(kind: str, count: int, seed: int = 0) -> Iterator[np.ndarray]:
    """Draw layouts (int8 [H, W]) that are far from any rule: noise, stripes, pockets, one tile."""
    domain, rng = find_domain(kind), np.random.default_rng(seed)
    (height, width), kinds = domain.generated_shape, len(domain.generated)
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
