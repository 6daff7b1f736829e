"""Options of studies: seeds, numbers of agents, what must stay, what a known size gives."""

import os.path
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from qdenv.domains.base import FREE, SAME, Domain, KnownSize, check_shape, make_domain
from qdenv.grid import rectangle
from qdenv.io.formats import READ_ENDINGS
from qdenv.io.layouts import BLANKS, aliases, alphabet, read_drawing
from qdenv.ranges import LARGEST_SEED
from qdenv.repairs.rules import impossible
from qdenv.simulation.mapf.goals import check_playable
from qdenv.surrogates.settings import PUBLISHED, SurrogateConfig
from qdenv.types import InputError, TaskRule, about, look_up

AGENTS, TIMESTEPS = 200, 1000  # of a simulation on a layout of no known size
_SURROGATES = {"small": SurrogateConfig(), "published": PUBLISHED}
_MOST_SEEDS = 100_000
_MOST_COUNTS = 1000  # numbers of agents in one study
# What must stay: one part, several joined by "+", or a list of these; see `keep_from`.
Keep: TypeAlias = str | Path | Sequence[str | Path]


def parse_seeds(seeds: int | str | Sequence[int]) -> tuple[int, ...]:
    """Read seeds: 10 or "10" for ten seeds from 0 on; (3, 5) or "3,5" for these, (7,) or "7,".

    Raises InputError if there is no seed, one is named twice, or one is out of range.
    """
    # A comma makes it a list: "7," is the seed 7, "7" are seven seeds.
    text = "".join(f"{one}," for one in np.ravel(seeds)) if np.ndim(seeds) else str(seeds)
    try:
        numbers = [int(part) for part in text.split(",") if part.strip()]
    except ValueError:
        numbers = []
    if not numbers or min(numbers) < 0 or max(numbers) > LARGEST_SEED:
        raise InputError(f"seeds {text!r}: write 10 for ten seeds, 3,5,9 for these, 7, for one")
    if len(set(numbers)) < len(numbers):
        raise InputError(f"seeds {text!r} names a seed twice: name each once")
    if "," in text:
        return tuple(numbers)
    if not 1 <= numbers[0] <= _MOST_SEEDS:
        raise InputError(f"seeds {text!r}: simulate at least one seed, and at most {_MOST_SEEDS:,}")
    return tuple(range(numbers[0]))


def parse_counts(agents: int | str | Sequence[int] | None) -> tuple[int, ...]:
    """Read numbers of agents: 200, (50, 100), "50,100", or "50:400:50", a range with its end.

    None are none. Raises InputError if it is none of these, a count is below one or named twice, or
    there are too many.
    """
    if agents is None or not np.size(agents):
        return ()
    text = ",".join(map(str, np.atleast_1d(agents).tolist()))
    counts: Sequence[int]
    try:
        if ":" in text:
            first, last, *step = numbers = [int(part) for part in text.split(":")]
            # Cut before it is listed: 1:99999999999 must be refused at once.
            counts = range(first, last + 1, *step)[: _MOST_COUNTS + 1] if min(numbers) > 0 else ()
        else:
            counts = [int(part) for part in text.split(",")]
    except (ValueError, TypeError):
        raise InputError(f"agents {text!r}: write 200, or 50,100, or 50:400:50") from None
    if not counts or min(counts) < 1:
        raise InputError(f"agents {text!r}: numbers must be above zero, and ranges must rise")
    if len(counts) > _MOST_COUNTS:
        cure = "choose a larger step, as in 50:400:50"
        raise InputError(f"agents {text!r} are more than {_MOST_COUNTS} numbers: {cure}")
    if len(set(counts)) < len(counts):
        raise InputError(f"agents {text!r} names a number twice: name each once")
    return tuple(counts)


def keep_from(
    keep: Keep, domain: Domain, layout: np.ndarray | None = None, folder: Path = Path()
) -> Domain:
    """Make cells of a domain at a plan's size stay as in the plan (int8 [H, W], or None).

    Each part of `keep` is one of three: tiles, all of whose cells stay (``w#``); a rectangle of
    rows and columns, the last ones not included (``0:7,33:40``); or the file of a drawing of the
    plan's shape in any format of layouts, where ``?`` is free to change, ``!`` stays as the plan
    has it, and a tile stays this tile. A drawing decides about every cell, tiles and rectangles add
    to it, or to what stays already. Names of files are relative to `folder`. Raises InputError if a
    part is none of the three, names what the plan does not hold, or no layout can be like this.
    """
    rows, cols = domain.shape
    cells = np.array([list(row) for row in domain.config.keep or [FREE * cols] * rows])
    symbols = None if layout is None else np.array(list(domain.tiles), object)[layout]
    parts = list(_split(keep, domain, folder))
    # Drawings first: they would free what others keep.
    for part in sorted(parts, key=lambda part: not isinstance(part, Path)):
        if isinstance(part, Path):
            drawing = read_drawing(part).rows
            with about(str(part)):
                cells = _read_cells(drawing, domain, symbols)
            continue
        if symbols is None:
            raise InputError(f"keep {part}: this needs a plan: give --plan FILE")
        if found := rectangle(part, symbols.shape):
            cells[found] = symbols[found]
            continue
        inside = np.isin(symbols, list(part))
        if not inside.any():
            raise InputError(f"keep {part}: the plan of {rows} x {cols} has no such cell")
        cells = np.where(inside, symbols, cells)
    with about(str(parts[0]) if len(parts) == 1 else "keep"):
        kept = make_domain(replace(domain.config, keep=tuple(map("".join, cells))))
        if kept.rules and (reason := impossible(kept.rules())):
            raise InputError(f"no layout obeys the rules with these cells kept: {reason}")
    return kept


def _split(keep: Keep, domain: Domain, folder: Path) -> Iterator[str | Path]:
    """Split what must stay into its parts: drawings become paths, the others stay text."""
    for one in [keep] if isinstance(keep, str | Path) else keep:
        whole = isinstance(one, Path) and (folder / one).exists()
        for part in [str(one)] if whole else str(one).split("+"):
            tiles, path = bool(part) and set(part) <= set(domain.tiles), folder / part
            if tiles or rectangle(part, domain.shape):
                yield part
            elif part and (path.suffix.lower() in READ_ENDINGS or os.path.exists(path)):
                yield path
            else:
                forms = "tiles like w#, rows and columns like 0:7,33:40, or the file of a drawing"
                raise InputError(f"keep {part!r}: give {forms}; + joins several")


def _read_cells(rows: Sequence[str], domain: Domain, symbols: np.ndarray | None) -> np.ndarray:
    """Read a drawing of what must stay: a tile or `FREE` for each cell ([H, W])."""
    # Blanks are no second symbol of floor in such a drawing; they may be the outside.
    known: dict[str, Any] = aliases(domain.tiles, domain.meanings)
    own = {
        one: tile
        for one, tile in known.items()
        if one not in FREE + SAME and not {one, tile} <= set(BLANKS)
    }
    if " " in own:
        rows = [row.ljust(domain.shape[1]) for row in rows]
    rows = [row.translate(str.maketrans(own)) for row in rows]
    check_shape(rows, domain.shape)
    drawn = np.array([list(row) for row in rows], object)
    for row, column in np.argwhere(~np.isin(drawn, list(FREE + SAME + domain.tiles))):
        none = f"{drawn[row, column]!r} is not a tile of {domain.name}"
        others = f"{FREE!r} where anything may be, {SAME!r} for what the plan holds"
        cure = f"draw {others}, or one of {alphabet(domain.tiles, domain.meanings)}"
        raise InputError(f"row {row}, column {column}: {none}: {cure}")
    if symbols is None:
        for row, column in np.argwhere(drawn == SAME):
            none = f"{SAME!r} stands for a plan's tile: add --plan FILE, or draw the tile itself"
            raise InputError(f"row {row}, column {column}: {none}")
        return drawn
    for row, column in np.argwhere((drawn != FREE) & (drawn != SAME) & (drawn != symbols)):
        stays = f"{drawn[row, column]!r} is to stay, but the plan holds {symbols[row, column]!r}"
        cure = f"change one of the two, or draw {FREE!r}"
        raise InputError(f"row {row}, column {column}: {stays} there: {cure}")
    return np.where(drawn == SAME, symbols, drawn)


def find_surrogate(size: str, numbers: Mapping[str, Any]) -> SurrogateConfig:
    """Return the settings of a surrogate: "small" or "published", with changes that are not None.

    Raises InputError if a name is unknown, or a number is impossible.
    """
    changes = {name: value for name, value in numbers.items() if value is not None}
    chosen: SurrogateConfig = look_up(_SURROGATES, size, "size")
    for name in changes:
        look_up(vars(chosen), name, "setting")
    return replace(chosen, **changes)


def fleet_tasks(layout: np.ndarray, tasks: TaskRule | None, agents: int) -> TaskRule:
    """Return what the agents do, if a simulation can begin.

    Raises InputError if no fleet drives in this domain, or that many do not fit the layout.
    """
    if tasks is None:
        raise InputError("no fleet drives in this domain: maps need --domain map")
    check_playable(layout, tasks, agents)
    return tasks


def usual_fleet(
    domain: Domain,
    layouts: Sequence[np.ndarray],
    agents: int | None = None,
    timesteps: int | None = None,
) -> tuple[int, int, str]:
    """Return agents, timesteps, and a line about what the layouts' size gives of them, or "".

    A number that is None is that of the size where all layouts have one known size, else `AGENTS`
    or `TIMESTEPS`.
    """
    shapes = {layout.shape for layout in layouts}
    size = domain.known_size(*shapes.pop()) if len(shapes) == 1 else None
    usual = (AGENTS, TIMESTEPS) if size is None else (size.agents, size.timesteps)
    taken: dict[str, int] = {}
    if agents is None:
        agents = taken["agents"] = usual[0]
    if timesteps is None:
        timesteps = taken["timesteps"] = usual[1]
    note = "" if size is None else _describe_size(layouts[0].shape, size, taken)
    return agents, timesteps, note


def describe_growth(domain: Domain, shape: tuple[int, int], given: Collection[str]) -> str:
    """Describe which numbers a known size gives to a layout that is drawn for it; "" for none.

    `domain` is at the size that the layout is made from; `given` holds the names of the numbers
    that were stated, "steps" among them where nothing grows.
    """
    size = domain.known_size(*shape)
    if size is None:
        return ""
    numbers = {**size.numbers, "steps": size.steps}
    taken = {name: value for name, value in numbers.items() if name not in given}
    return _describe_size(shape, size, taken).replace(" steps", " steps of growth")


def _describe_size(shape: tuple[int, ...], size: KnownSize, taken: dict[str, int]) -> str:
    if not taken:
        return ""
    numbers = ", ".join(f"{value} {name}" for name, value in taken.items())
    return f"{shape[0]} x {shape[1]} is {size.about}: {numbers} unless stated"
