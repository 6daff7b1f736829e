"""Elites of a saved run: find one, grow it on a canvas of any size, repair what it drew."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from qdenv.domains.base import Domain, make_domain
from qdenv.generate import GENERATORS, Generator
from qdenv.lazy import jax, jnp
from qdenv.ranges import NonNegativeInt, check_range
from qdenv.repair.rules import Progress, impossible, no_progress
from qdenv.repair.settings import RepairConfig
from qdenv.run.archive import Elite
from qdenv.run.directory import RunDirectory
from qdenv.settings import EvaluationConfig
from qdenv.study.plans import keep_from
from qdenv.types import InputError, Repair, RepairStatus


class Grown(NamedTuple):
    """A layout drawn for one size, unrepaired."""

    domain: Domain  # at the layout's size, with the numbers that its repair will demand
    elite: Elite | None  # whose layout; None where no elite drew it (a tiled layout)
    layout: np.ndarray  # int8 [H, W]
    steps: int  # of growth; 0 where nothing grew


def find_elite(
    run: RunDirectory,
    which: str | Sequence[int] = "best",
    measures: Sequence[float] | None = None,
) -> Elite:
    """Find an elite.

    Args:
        run: a run that has saved an archive.
        which: "best", or the cell's indices: "12,40" or (12, 40).
        measures: a value for each measure, in place of `which`: the elite there, or the nearest.

    Raises:
        InputError: there is no archive, no elite in that cell, or the question has no such form.
    """
    return run.archive.elite(which, measures)


def grow_series(
    config: EvaluationConfig, domain: Domain, solution: np.ndarray, steps: Sequence[int]
) -> list[np.ndarray]:
    """Grow one solution and keep the framed layout after each number of steps (Figure 6).

    Args:
        config: whose generator.
        domain: at the size to draw.
        solution: float32 [P].
        steps: numbers of steps.

    Returns:
        one unrepaired layout int8 [H, W] for each entry of `steps`.

    Raises:
        InputError: the canvas is smaller than the seed block or the frame, or the solution is
            one of another architecture, or a number of steps is negative.
    """
    check_range("steps", tuple(steps), tuple[NonNegativeInt, ...])
    generator = _generator_of(config, domain)
    if generator.choices and solution.shape != (generator.size,):
        raise InputError(
            "this run searched tiles, not automata: its layouts have the size of the run alone"
        )
    if solution.shape != (generator.size,):
        raise InputError(f"{len(solution)} parameters given, this generator has {generator.size}")

    @jax.jit
    def grow(number: jax.Array) -> jax.Array:
        # As a population of one, the very way layouts grow during a search.
        return jnp.asarray(domain.frame(generator.grow(jnp.asarray(solution)[None], number)[0]))

    return [np.asarray(grow(jnp.asarray(number, jnp.int32))) for number in steps]


def _generator_of(config: EvaluationConfig, domain: Domain) -> Any:
    # Only here: imports both compilers, and who is refused need not wait.
    from qdenv.pipeline import canvas_of

    return GENERATORS.make(config.generator, canvas_of(domain))


def grow_elite(
    run: RunDirectory,
    which: str | Sequence[int] | Elite = "best",
    shape: tuple[int | None, int | None] = (None, None),
    steps: int | None = None,
    numbers: Mapping[str, int] | None = None,
    keep: Path | None = None,
) -> Grown:
    """Grow an elite of a run at any size; nothing is repaired yet.

    Args:
        run: the run.
        which: an elite, or as in `find_elite`.
        shape: (rows, columns) of the framed layout; None takes the trained size.
        steps: steps of growth; unless given what the domain knows of the size, or else scaled
            with the longer side.
        numbers: exact numbers of tiles by the settings' names; those left out as well, scaled
            with the generated area.
        keep: drawing of the layout's shape with the tiles that must stay; at the trained size
            what the run kept unless given.

    Raises:
        InputError: there is no such elite, the size is impossible, or what must stay is.
    """
    config = run.config.evaluation
    trained = make_domain(config.domain)
    rows, cols = shape[0] or trained.shape[0], shape[1] or trained.shape[1]
    domain = trained.resized(rows, cols, numbers)
    if keep is not None:
        domain = keep_from(keep, domain)
    if steps is None:
        size, longer = (
            trained.known_size(rows, cols),
            max(rows / trained.shape[0], cols / trained.shape[1], 1),
        )
        own = _generator_of(config, trained).steps
        steps = size.steps if size and own else round(own * longer)
    elite = which if isinstance(which, Elite) else find_elite(run, which)
    layout = grow_series(config, domain, elite.solution, [steps])[0]
    return Grown(domain, elite, layout, steps)


def repair_grown(
    grown: Grown, config: RepairConfig, seed: int = 0, progress: Progress = no_progress
) -> Repair | None:
    """Repair a grown layout; None where its domain has no rules.

    Args:
        grown: the layout.
        config: limits of the repair.
        seed: other seeds give other, equally good repairs.
        progress: called with what is being done, and from 0 to 1 how much of it is.

    Raises:
        InputError: no layout of this size obeys the rules, or none was found.
    """
    domain = grown.domain
    if domain.rules is None:
        return None
    # Only here: imports a compiler and a solver.
    from qdenv.repair.recipe import repair_layout

    rules = domain.rules()
    result = repair_layout(grown.layout, rules, seed, config, progress)
    if result.status >= RepairStatus.IMPOSSIBLE:
        rows, cols = domain.shape
        demanded = "".join(f" with {number} {name}" for name, number in domain.numbers.items())
        raise InputError(
            f"no repair of {rows} x {cols}{demanded}: "
            f"{impossible(rules) or 'none was found, try another repair seed'}"
        )
    return result


Grower = Callable[[np.ndarray], np.ndarray]


def make_grower(config: EvaluationConfig, domain: Domain) -> tuple[int, Grower]:
    """Make the function that grows solutions at the trained size and keeps every step.

    Args:
        config: whose generator, and how many steps.
        domain: at the trained size.

    Returns:
        (steps C, float32 [B, P] -> framed layouts int8 [B, C + 1, H, W]); no steps where nothing
        grows. Another B is compiled again.
    """
    from qdenv.pipeline import canvas_of  # imports both compilers

    generator = GENERATORS.make(config.generator, canvas_of(domain))
    steps = generator.steps

    @jax.jit
    def grow(solutions: jax.Array) -> jax.Array:
        framed = jax.vmap(jax.vmap(domain.frame))(_frames(generator, solutions, steps))
        return jnp.asarray(framed)

    return steps, lambda solutions: np.asarray(grow(jnp.asarray(solutions)))


def _frames(generator: Generator, solutions: jax.Array, steps: int) -> jax.Array:
    if generator.frames is not None:
        return generator.frames(solutions, steps)
    # Whoever tells only how it ends is asked again and again.
    after = jnp.arange(steps + 1)
    return jnp.moveaxis(jax.lax.map(lambda step: generator.grow(solutions, step), after), 0, 1)


def spread(cells: np.ndarray, first: int) -> Iterator[int]:
    """Order elites so that the first few of them, however many, lie evenly over the archive.

    Each is the one farthest from all before it (Gonzalez 1985, "Clustering to minimize the maximum
    intercluster distance", https://doi.org/10.1016/0304-3975(85)90224-5).

    Args:
        cells: int [elites, M], where they lie.
        first: row of the one to begin with.

    Yields:
        each row once.
    """
    points = cells.astype(np.int32)
    distance = np.full(len(points), np.iinfo(np.int32).max)
    row = first
    for _ in range(len(points)):
        yield row
        np.minimum(distance, ((points - points[row]) ** 2).sum(axis=1), out=distance)
        distance[row] = -1
        row = int(distance.argmax())
