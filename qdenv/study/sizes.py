"""Layouts of other sizes: grown by one elite (E.3), designed by hand, tiled (E.4)."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from qdenv.domains.base import Domain
from qdenv.generate import inside_frame
from qdenv.io.files import write_csv
from qdenv.ranges import PositiveInt, check_range
from qdenv.repair.settings import RepairConfig
from qdenv.run.directory import RunDirectory
from qdenv.study.elites import Grown, grow_elite, grow_series, repair_grown
from qdenv.types import InputError, Repair, RepairStatus

# Rows and columns of Figure 18, from S to S_eval.
SIZES = ((33, 36), (45, 47), (57, 58), (69, 69), (81, 80), (93, 91), (101, 102))


class Sized(NamedTuple):
    """One layout of a series and how it came about."""

    layout: np.ndarray  # int8 [H, W], repaired where the domain repairs
    steps: int  # of growth; 0 for a tiled layout
    numbers: dict[str, int]  # how many tiles of each counted kind it holds, by the settings' names
    repair: str  # a RepairStatus by name, "none" where nothing was repaired
    changed: int  # cells that the repair changed
    cpu_seconds: float  # of the repair


def details(sized: Sized) -> dict[str, int | float | str]:
    """List what a table says of a layout."""
    rows, cols = sized.layout.shape
    return {
        "rows": rows,
        "cols": cols,
        "steps": sized.steps,
        **sized.numbers,
        "repair": sized.repair,
        "changed": sized.changed,
        "cpu_seconds": sized.cpu_seconds,
    }


def write_series(path: Path, series: Sequence[Sized]) -> None:
    """Write the table of a series as CSV, a row per layout."""
    write_csv(path, list(details(series[0])), [list(details(sized).values()) for sized in series])


def parse_size(text: str) -> tuple[int, int]:
    """Read a size like ``57x58`` (rows x columns).

    Raises:
        InputError: it is none.
    """
    rows, _, cols = text.partition("x")
    if not (rows.isdecimal() and cols.isdecimal() and int(rows) and int(cols)):
        raise InputError(f"size {text!r}: give rows and columns like 57x58")
    return int(rows), int(cols)


def grow_sizes(
    run: RunDirectory,
    which: str = "best",
    sizes: Sequence[tuple[int, int]] = SIZES,
    steps: Sequence[int] = (),
    numbers: Mapping[str, Sequence[int]] | None = None,
    seed: int | None = None,
) -> Iterator[Sized]:
    """Grow one elite at several sizes and repair each layout.

    Args:
        run: a run with an archive.
        which: "best", or the archive cell's indices like "12,40".
        sizes: rows and columns of each framed layout.
        steps: steps of growth for each size; as `grow_elite` chooses where empty.
        numbers: exact numbers of tiles for each size, by the settings' names.
        seed: of the repair; the run's own unless given.

    Yields:
        the layouts in the order of `sizes`, each as soon as it is repaired.

    Raises:
        InputError: there is no such elite, a size is impossible, or a list has another length
            than `sizes`.
    """
    given = dict(numbers or {})
    for name, values in {"steps": steps, **given}.items():
        if values and len(values) != len(sizes):
            raise InputError(f"{len(values)} numbers of {name} for {len(sizes)} sizes: give all")
    config = run.config
    seed = config.seed if seed is None else seed
    for index, shape in enumerate(sizes):
        own = {name: values[index] for name, values in given.items() if values}
        grown = grow_elite(run, which, shape, steps[index] if steps else None, own)
        yield finish(grown, config.evaluation.repair, seed)


def grow_frames(run: RunDirectory, grown: Grown, every: int) -> tuple[list[int], list[np.ndarray]]:
    """Grow an elite once more and keep what it drew on the way (Figure 6).

    Args:
        run: the elite's run.
        grown: the elite and the size.
        every: steps from one frame to the next; the last step is always among them.

    Returns:
        the numbers of steps, and the unrepaired layout (int8 [H, W]) after each.

    Raises:
        InputError: `every` is not positive, or no elite drew the layout.
    """
    check_range("every", every, PositiveInt)
    if grown.elite is None:
        raise InputError("a tiled layout did not grow: it has no frames")
    steps = sorted({*range(0, grown.steps, every), grown.steps})
    return steps, grow_series(run.config.evaluation, grown.domain, grown.elite.solution, steps)


def finish(grown: Grown, config: RepairConfig, seed: int) -> Sized:
    """Repair a layout and count what that changed.

    Raises:
        InputError: no layout of this size obeys the rules, or none was found.
    """
    before, domain = grown.layout, grown.domain
    repaired = repair_grown(grown, config, seed)
    after = before if repaired is None else np.asarray(repaired.layout)
    return Sized(
        layout=after,
        steps=grown.steps,
        numbers=domain.fitted(after).numbers,
        repair=_status_name(repaired),
        changed=int((before != after).sum()),
        cpu_seconds=0.0 if repaired is None else round(float(repaired.seconds), 3),
    )


def _status_name(repaired: Repair | None) -> str:
    """Name how a repair ended, in small letters; "none" where there was no repair."""
    return "none" if repaired is None else RepairStatus(int(repaired.status)).name.lower()


def human_layout(domain: Domain) -> np.ndarray:
    """Draw what people design for `domain` at its size (int8 [H, W]; appendix D.2).

    Raises:
        InputError: no layouts of this domain are designed by hand, or the size is too small.
    """
    if domain.human is None:
        raise InputError(f"nobody designs layouts of {domain.name} by hand: choose another domain")
    return domain.human()


def tile_layout(domain: Domain, layout: np.ndarray) -> np.ndarray:
    """Repeat the generated area of a small layout until it fills a larger one (section E.4).

    The copies start in the upper left corner; those at the right and at the bottom are cut. The
    frame is drawn again.

    Args:
        domain: at the larger size.
        layout: int8 [h, w], framed.

    Returns:
        int8 [H, W], not repaired.

    Raises:
        InputError: the larger layout is smaller than the frame.
    """
    inside = inside_frame(layout, domain.margin)
    wanted = domain.generated_shape
    if min(wanted) < 1 or inside.size == 0:
        rows, cols = domain.shape
        raise InputError(f"{rows} x {cols} leaves no room inside the frame: ask for more")
    copies = [-(-side // own) for side, own in zip(wanted, inside.shape, strict=True)]
    return np.asarray(domain.frame(np.tile(inside, copies)[: wanted[0], : wanted[1]]))


def tile(
    domain: Domain,
    layout: np.ndarray,
    shape: tuple[int, int],
    numbers: Mapping[str, int] | None = None,
    config: RepairConfig | None = None,
    seed: int = 0,
) -> Sized:
    """Tile a small layout to a larger size and repair it: the baseline of section E.4.

    Args:
        domain: whose rules, at any size.
        layout: int8 [h, w], framed.
        shape: rows and columns of the larger layout.
        numbers: exact numbers of tiles by the settings' names; where left out those known of the
            size, or else the small layout's, scaled with the area.
        config: limits of the repair.
        seed: other seeds give other, equally good repairs.

    Raises:
        InputError: the size is impossible, or no repair was found.
    """
    larger = domain.fitted(layout).resized(*shape, numbers)
    grown = Grown(larger, None, tile_layout(larger, layout), 0)
    return finish(grown, config or RepairConfig(), seed)
