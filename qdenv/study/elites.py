"""Elites of a saved run: find one, grow it on a canvas of any size, repair what it drew."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np

from qdenv.domains import find_domain
from qdenv.domains.base import Domain, EvaluationConfig
from qdenv.generate.decode import choose_tiles
from qdenv.generate.nca import grow_population, make_generator, seed_canvas
from qdenv.repair.bounds import impossible
from qdenv.repair.recipe import RepairConfig, repair
from qdenv.train.records import RunDirectory
from qdenv.types import InputError, Repair, RepairStatus


class Elite(NamedTuple):
    """One filled cell of a run's archive."""

    solution: np.ndarray  # float32 [P]
    objective: float
    cell: tuple[int, ...]  # index along each measure


class Grown(NamedTuple):
    """An elite's layout at some size, unrepaired."""

    domain: Domain
    elite: Elite | None  # None where no elite drew it: a tiled layout
    layout: np.ndarray  # int8 [H, W]
    steps: int
    shelves: int


def find_elite(run: RunDirectory, which: str = "best") -> Elite:
    """Find an elite.

    Args:
        run: a run that has saved an archive.
        which: "best", or the cell's indices like "12,40".

    Raises:
        InputError: there is no archive, no elite in that cell, or `which` is neither form.
    """
    archive = run.load_archive()
    shape = tuple(measure.cells for measure in run.measures)
    if len(archive["index"]) == 0:
        raise InputError(f"{run.path}: the archive is empty, no solution succeeded yet")
    if which == "best":
        row = int(np.argmax(archive["objective"]))
    else:
        try:
            cell = tuple(int(part) for part in which.split(","))
            rows = np.flatnonzero(archive["index"] == np.ravel_multi_index(cell, shape))
        except ValueError as error:
            raise InputError(
                f'elite {which!r}: give "best" or indices below {shape} like "3,7"'
            ) from error
        if len(rows) == 0:
            nearest = np.stack(np.unravel_index(archive["index"], shape), axis=-1)
            distance = np.abs(nearest - np.array(cell)).sum(axis=1)
            hint = ",".join(map(str, nearest[np.argmin(distance)]))
            raise InputError(f"elite {which!r}: this cell is empty, the nearest elite is {hint}")
        row = int(rows[0])
    cell = tuple(int(index) for index in np.unravel_index(archive["index"][row], shape))
    return Elite(archive["solution"][row], float(archive["objective"][row]), cell)


def scaled_shelves(domain: Domain, config: EvaluationConfig, rows: int, cols: int) -> int:
    """Scale the number of shelves with the generated area, from the size it was trained at."""
    dr, dc = domain.margin
    trained = (config.rows - 2 * dr) * (config.cols - 2 * dc)
    return round(config.shelves * (rows - 2 * dr) * (cols - 2 * dc) / trained)


def grow_series(
    domain: Domain,
    config: EvaluationConfig,
    solution: np.ndarray,
    shape: tuple[int, int],
    steps: Sequence[int],
) -> list[np.ndarray]:
    """Grow one solution and keep the framed layout after each number of steps (Figure 6).

    Args:
        domain: whose tiles and frame.
        config: whose architecture.
        solution: float32 [P].
        shape: (rows, columns) of the framed layout.
        steps: numbers of NCA steps.

    Returns:
        one unrepaired layout int8 [rows, columns] for each entry of `steps`.

    Raises:
        InputError: the canvas is smaller than the seed block or the frame, or the solution is
            one of another architecture.
    """
    rows, cols = (side - 2 * margin for side, margin in zip(shape, domain.margin, strict=True))
    start = seed_canvas(domain.seed_block, rows, cols, domain.generated)
    generator = make_generator(len(domain.generated), config.kernel_sizes, config.hidden)
    if solution.shape != (generator.size,):
        raise InputError(f"{len(solution)} parameters given, this NCA has {generator.size}")

    @jax.jit
    def grow(number: int) -> jax.Array:
        # As a population of one, the very way layouts grow during a search.
        cells = grow_population(generator, solution[None], start, number)[0]
        return domain.frame(choose_tiles(cells))

    return [np.asarray(grow(number)) for number in steps]


def grow_elite(
    run: RunDirectory,
    which: str = "best",
    shape: tuple[int | None, int | None] = (None, None),
    steps: int | None = None,
    shelves: int | None = None,
) -> Grown:
    """Grow an elite of a run at any size; nothing is repaired yet.

    Args:
        run: the run.
        which: see `find_elite`.
        shape: (rows, columns) of the framed layout; None takes the trained size.
        steps: NCA steps; scaled with the longer side unless given.
        shelves: exact number of shelves; scaled with the area unless given.

    Raises:
        InputError: there is no such elite, or the size is impossible.
    """
    config = run.config.evaluation
    domain = find_domain(config.domain)
    rows, cols = shape[0] or config.rows, shape[1] or config.cols
    if steps is None:
        steps = round(config.steps * max(rows / config.rows, cols / config.cols, 1))
    elite = find_elite(run, which)
    layout = grow_series(domain, config, elite.solution, (rows, cols), [steps])[0]
    if shelves is None:
        shelves = scaled_shelves(domain, config, rows, cols)
    return Grown(domain, elite, layout, steps, shelves)


def repair_grown(grown: Grown, config: RepairConfig, seed: int = 0) -> Repair | None:
    """Repair a grown layout; None where its domain has no rules.

    Raises:
        InputError: no layout of this size obeys the rules, or none was found.
    """
    if grown.domain.rules is None:
        return None
    rules = grown.domain.rules(*grown.layout.shape, grown.shelves)
    result = repair(grown.layout, rules, seed, config)
    if result.status >= RepairStatus.IMPOSSIBLE:
        rows, cols = grown.layout.shape
        raise InputError(
            f"no repair of {rows} x {cols} with {grown.shelves} shelves: "
            f"{impossible(rules) or 'none was found, try another repair seed'}"
        )
    return result
