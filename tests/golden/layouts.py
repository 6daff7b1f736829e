"""Layouts of fixed seeds for the golden corpus."""

import dataclasses
import zlib

import adapter
import numpy as np

WAREHOUSES = ("warehouse-even", "warehouse-uneven")
SHAPES = [(7, 9), (9, 10), (11, 13), (13, 12), (14, 17), (17, 16), (20, 20), (33, 36)]


def generator_of(name: str) -> np.random.Generator:
    """Make the random numbers of one case."""
    return np.random.default_rng(zlib.crc32(name.encode()))


def random_layout(kind: str, shape: tuple[int, int], name: str, dense: float = 0.2) -> tuple:
    """Draw tiles at random; return the framed layout and its domain.

    Args:
        kind: name of the domain.
        shape: rows and columns.
        name: of the case, which decides the tiles.
        dense: shelves per generated cell that the rules demand.
    """
    rng = generator_of(name)
    numbers = {}
    if kind in WAREHOUSES:
        numbers["shelves"] = max(1, round(dense * shape[0] * (shape[1] - 4)))
    domain = adapter.domain_of(kind, *shape, **numbers)
    odds = rng.dirichlet(np.full(len(domain.generated), 2.0))
    area = rng.choice(len(odds), size=domain.generated_shape, p=odds).astype(np.int8)
    if name.endswith("blocks"):  # as a generator draws: patches of one tile
        area = np.repeat(np.repeat(area[::3, ::3], 3, 0), 3, 1)[: area.shape[0], : area.shape[1]]
    return np.asarray(domain.frame(area)), domain


def keep_some(layout: np.ndarray, domain: adapter.qdenv.Domain, name: str) -> object:
    """Demand that some cells stay as they are."""
    kept = generator_of(name + " kept").random(layout.shape) < 0.04
    rows = [
        "".join(domain.tiles[tile] if keep else "?" for tile, keep in zip(*both, strict=True))
        for both in zip(layout, kept, strict=True)
    ]
    return adapter.qdenv.make_domain(dataclasses.replace(domain.config, keep=tuple(rows)))
