"""Layouts of other sizes: grown by one elite (E.3), designed by hand, tiled (E.4)."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from qdenv.domains.base import Domain, EvaluationConfig
from qdenv.files import write_csv
from qdenv.generate.decode import inside_frame
from qdenv.repair.recipe import RepairConfig
from qdenv.study.elites import Grown, grow_elite, grow_series, repair_grown, scaled_shelves
from qdenv.train.records import RunDirectory
from qdenv.types import InputError, Repair, RepairStatus

# Rows and columns of Figure 18, from S to S_eval.
SIZES = ((33, 36), (45, 47), (57, 58), (69, 69), (81, 80), (93, 91), (101, 102))


class Sized(NamedTuple):
    """One layout of a series and how it came about; all but `layout` is a row of the table."""

    layout: np.ndarray  # int8 [H, W], repaired where the domain repairs
    rows: int
    cols: int
    steps: int  # NCA steps; 0 for a tiled layout
    shelves: int
    repair: str  # a RepairStatus by name, "none" where nothing was repaired
    changed: int  # cells that the repair changed
    cpu_seconds: float  # of the repair


def details(sized: Sized) -> dict[str, int | float | str]:
    """List what a table says of a layout: every field but the layout itself."""
    return {name: value for name, value in sized._asdict().items() if name != "layout"}


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
    shelves: Sequence[int] = (),
    seed: int | None = None,
) -> Iterator[Sized]:
    """Grow one elite at several sizes and repair each layout.

    Args:
        run: a run with an archive.
        which: "best", or the archive cell's indices like "12,40".
        sizes: rows and columns of each framed layout.
        steps: NCA steps for each size; scaled with the size where empty.
        shelves: number of shelves for each size; scaled with the area where empty.
        seed: of the repair; the run's own unless given.

    Yields:
        the layouts in the order of `sizes`, each as soon as it is repaired.

    Raises:
        InputError: there is no such elite, a size is impossible, or a list has another length
            than `sizes`.
    """
    for name, numbers in (("steps", steps), ("shelves", shelves)):
        if numbers and len(numbers) != len(sizes):
            raise InputError(f"{len(numbers)} numbers of {name} for {len(sizes)} sizes: give all")
    config = run.config
    seed = config.seed if seed is None else seed
    for index, shape in enumerate(sizes):
        grown = grow_elite(
            run,
            which,
            shape,
            steps[index] if steps else None,
            shelves[index] if shelves else None,
        )
        yield finish(grown, config.evaluation.repair, seed)


def grow_frames(run: RunDirectory, grown: Grown, every: int) -> tuple[list[int], list[np.ndarray]]:
    """Grow an elite once more and keep what it drew on the way (Figure 6).

    Args:
        run: the elite's run.
        grown: the elite and the size.
        every: NCA steps from one frame to the next; the last step is always among them.

    Returns:
        the numbers of steps, and the unrepaired layout (int8 [H, W]) after each.

    Raises:
        InputError: `every` is not positive.
    """
    if every < 1:
        raise InputError(f"a frame every {every} steps: give 1 or more")
    steps = sorted({*range(0, grown.steps, every), grown.steps})
    solution, shape = grown.elite.solution, grown.layout.shape
    return steps, grow_series(grown.domain, run.config.evaluation, solution, shape, steps)


def finish(grown: Grown, config: RepairConfig, seed: int) -> Sized:
    """Repair a layout and count what that changed.

    Raises:
        InputError: no layout of this size obeys the rules, or none was found.
    """
    before, domain = grown.layout, grown.domain
    repaired = repair_grown(grown, config, seed)
    after = before if repaired is None else repaired.layout
    return Sized(
        layout=after,
        rows=before.shape[0],
        cols=before.shape[1],
        steps=grown.steps,
        shelves=count_shelves(domain, after),
        repair=status_name(repaired),
        changed=int((before != after).sum()),
        cpu_seconds=0.0 if repaired is None else float(repaired.seconds),
    )


def status_name(repaired: Repair | None) -> str:
    """Name how a repair ended, in small letters; "none" where there was no repair."""
    return "none" if repaired is None else RepairStatus(int(repaired.status)).name.lower()


def count_shelves(domain: Domain, layout: np.ndarray) -> int:
    """Count the shelves of a layout (int8 [H, W]); 0 where the domain has none."""
    return int((layout == domain.tiles.find("@")).sum())


def human_layout(domain: Domain, rows: int, cols: int) -> np.ndarray:
    """Draw what people design for `domain` at this size (int8 [rows, cols]; appendix D.2).

    Raises:
        InputError: nobody designs layouts of this domain, or the size is too small.
    """
    if domain.design is None:
        raise InputError(f"nobody designs layouts of {domain.name} by hand: choose another domain")
    return domain.design(rows, cols)


def tile_layout(domain: Domain, layout: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Repeat the generated area of a small layout until it fills a larger one (section E.4).

    The copies start in the upper left corner; those at the right and at the bottom are cut. The
    frame is drawn anew.

    Args:
        domain: whose frame.
        layout: int8 [H, W], framed.
        shape: rows and columns of the larger framed layout.

    Returns:
        int8 [rows, cols], not repaired.

    Raises:
        InputError: the larger layout is smaller than the frame.
    """
    inside = inside_frame(layout, domain.margin)
    wanted = [side - 2 * margin for side, margin in zip(shape, domain.margin, strict=True)]
    if min(wanted) < 1 or inside.size == 0:
        raise InputError(f"{shape[0]} x {shape[1]} leaves no room inside the frame: ask for more")
    copies = [-(-side // own) for side, own in zip(wanted, inside.shape, strict=True)]
    return np.asarray(domain.frame(np.tile(inside, copies)[: wanted[0], : wanted[1]]))


def tile(
    domain: Domain,
    layout: np.ndarray,
    shape: tuple[int, int],
    shelves: int | None = None,
    config: RepairConfig | None = None,
    seed: int = 0,
) -> Sized:
    """Tile a small layout to a larger size and repair it: the baseline of section E.4.

    Args:
        domain: whose rules.
        layout: int8 [H, W], framed.
        shape: rows and columns of the larger layout.
        shelves: exact number of shelves; the small layout's, scaled with the area, unless given.
        config: limits of the repair.
        seed: other seeds give other, equally good repairs.

    Raises:
        InputError: the size is impossible, or no repair was found.
    """
    if shelves is None:
        rows, cols = layout.shape
        own = count_shelves(domain, layout)
        small = replace(EvaluationConfig(), rows=rows, cols=cols, shelves=own)
        shelves = scaled_shelves(domain, small, *shape)
    tiled = tile_layout(domain, layout, shape)
    return finish(Grown(domain, None, tiled, 0, shelves), config or RepairConfig(), seed)
