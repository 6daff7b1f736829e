"""Trained generators that ship: for each domain a small run whose elites have names.

qdenv/zoo/DOMAIN/config.json, manifest.json, metrics.csv   of the run they come from
qdenv/zoo/DOMAIN/archive.npz       the chosen elites alone
qdenv/zoo/DOMAIN/generators.json   their names and figures

`experiments/zoo.py` writes them; every command that takes a run takes ``zoo:DOMAIN/NAME``, too.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from qdenv.io.records import read_json
from qdenv.types import look_up

_HOME = Path(__file__).parent / "zoo"
PREFIX = "zoo:"
TABLE = "generators.json"
USUAL = "best"  # the generator of a domain where none is named


class Driven(NamedTuple):
    """What the simulations of one layout under one planner say."""

    # who drives: "high" effort of our planner, "published" priority-based search, or the "agent" of
    # mazes
    planner: str
    agents: int  # how many drive
    timesteps: int  # horizon T
    runs: int  # how many simulations, seeds 0, 1, ..
    mean: float  # of what is counted (`Origin.counted`), over all runs
    error: float | None  # its standard error; None with one run
    success: float  # share of the runs that did not congest, or reached the goal


class Grown(NamedTuple):
    """A generator's layout of one size."""

    rows: int  # of the layout
    cols: int  # of the layout
    steps: int  # of growth
    numbers: Mapping[str, int]  # exact numbers of tiles, by the settings' names
    repair: str  # how the repair ended
    changed: int  # cells it changed
    # of the repaired layout, as far as they need no simulation, by their names
    measures: Mapping[str, float]
    driven: tuple[Driven, ...]  # what simulations say, a record for each planner


class Generator(NamedTuple):
    """One generator."""

    name: str  # within its domain
    about: str  # a sentence
    cell: tuple[int, ...]  # where it stands in the archive, an index along each measure
    objective: float  # what the search thought of it
    sizes: tuple[Grown, ...]  # layouts of it, the trained size first


class Origin(NamedTuple):
    """The run that the generators of a domain come from."""

    run: str  # its name, that of a preset
    algorithm: str  # of the search
    seed: int  # its random seed
    evaluations: int  # done in all
    qdenv: str  # version that searched
    created: str  # when it began
    counted: str  # what is averaged over simulations, with its unit
    further: int = 0  # evaluations of runs that began at elites of this one, and gave some


class Collection(NamedTuple):
    """The generators of one domain."""

    domain: str  # its name
    folder: Path  # a run directory, which is only read
    origin: Origin  # where they come from
    generators: Mapping[str, Generator]  # by name


class Shipped(NamedTuple):
    """What a name in the zoo stands for."""

    collection: Collection  # the domain's
    name: str  # of the generator

    def __str__(self) -> str:
        """Say it as command lines do."""
        return f"{PREFIX}{self.collection.domain}/{self.name}"

    @property
    def refusal(self) -> str:
        """Say why nothing is written there, and what to do."""
        preset = self.collection.origin.run
        return (
            f"{self}: ships with qdenv and stays as it is: `qdenv train {preset}` makes a run of "
            "your own"
        )

    @property
    def generator(self) -> Generator:
        """The generator itself."""
        return self.collection.generators[self.name]

    @property
    def cells(self) -> dict[str, tuple[int, ...]]:
        """Cells of the archive by name; the best is the one that was asked for."""
        every = {one.name: one.cell for one in self.collection.generators.values()}
        return every | {USUAL: self.generator.cell}


def names() -> dict[str, tuple[str, ...]]:
    """List the domains of the zoo, each with the names of its generators."""
    found = sorted(path.parent for path in _HOME.glob(f"*/{TABLE}"))
    return {folder.name: tuple(read_collection(folder).generators) for folder in found}


def find(place: str | Path) -> Shipped | None:
    """Find what ``zoo:DOMAIN``, ``zoo:DOMAIN/NAME`` or the path of a folder of the zoo stands for.

    Args:
        place: a name or a path; links are followed.

    Returns:
        The generator; None for other places.

    Raises:
        InputError: nothing has this name; the line lists the choices.
    """
    text = place.as_posix() if isinstance(place, Path) else place
    if text.startswith(PREFIX):
        return named(text.removeprefix(PREFIX))
    folder = Path(os.path.realpath(text))  # unlike Path.resolve, it never raises
    if folder.parent != Path(os.path.realpath(_HOME)) or folder.name not in names():
        return None
    return named(folder.name)


def file_name(run_dir: Path) -> str:
    """Say what files made of a run are called after: its folder, or its name in the zoo."""
    shipped = find(run_dir)
    return f"{shipped.collection.domain}-{shipped.name}" if shipped else run_dir.resolve().name


def named(text: str) -> Shipped:
    """Find what ``DOMAIN`` or ``DOMAIN/NAME`` stands for.

    Raises:
        InputError: as in `find`.
    """
    domain, _, name = text.partition("/")
    look_up(names(), domain, "domain of the zoo")
    collection = read_collection(_HOME / domain)
    look_up(collection.generators, name or USUAL, f"generator of {domain}")
    return Shipped(collection, name or USUAL)


class _Table(NamedTuple):
    """The content of a folder's table."""

    domain: str
    origin: Origin
    generators: tuple[Generator, ...]


@lru_cache(maxsize=16)
def read_collection(folder: Path) -> Collection:
    """Read a folder of generators, whose table is that of `to_json`."""
    table = read_json(folder / TABLE, _Table)
    generators = {one.name: one for one in table.generators}
    return Collection(table.domain, folder, table.origin, generators)


def to_json(domain: str, origin: Origin, generators: Sequence[Generator]) -> dict[str, Any]:
    """Make the content of a folder's table."""
    listed = [
        one._asdict()
        | {
            "sizes": [
                size._asdict() | {"driven": [row._asdict() for row in size.driven]}
                for size in one.sizes
            ]
        }
        for one in generators
    ]
    return {"domain": domain, "origin": origin._asdict(), "generators": listed}
