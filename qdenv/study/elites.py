"""Layouts of any size: grown by an elite of a run (E.3), tiled (E.4)."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from qdenv.domains.base import Domain, make_domain
from qdenv.generators import GENERATORS, Generator
from qdenv.grid import checksum, inside_frame
from qdenv.guidance import unscaled_costs
from qdenv.lazy import jax, jnp
from qdenv.progress import Progress, silent
from qdenv.ranges import NonNegativeInt, PositiveInt, check_range
from qdenv.repairs.settings import RepairConfig
from qdenv.run.archive import Elite
from qdenv.run.directory import RunDirectory
from qdenv.settings import EvaluationConfig
from qdenv.study.options import Keep, keep_from
from qdenv.study.plans import Plan, keep_costs
from qdenv.types import Array, InputError, Repair, RepairStatus

# Rows and columns of Figure 18, from S to S_eval.
SIZES = ((33, 36), (45, 47), (57, 58), (69, 69), (81, 80), (93, 91), (101, 102))
_OTHER_DRAWING = (
    "%s: draws another plan of %d x %d here than is recorded (checksum %s, not %s), which an exact "
    "automaton never should: what is recorded of it does not hold for this plan"
)
_LOG = logging.getLogger(__name__)
Grower = Callable[[np.ndarray], np.ndarray]
CostsDrawer = Callable[[np.ndarray, np.ndarray], np.ndarray]


class Unrepaired(NamedTuple):
    """A layout drawn for one size, unrepaired."""

    domain: Domain  # at the layout's size, with the numbers that its repair will demand
    elite: Elite | None  # whose layout; None where no elite drew it (a tiled layout)
    layout: np.ndarray  # int8 [H, W]
    steps: int  # of growth; 0 where nothing grew
    repair: RepairConfig = RepairConfig()  # the run's if the run drew it, else in full


class Sized(NamedTuple):
    """A layout of some size and how it came about."""

    layout: np.ndarray  # int8 [H, W], repaired where the domain repairs
    steps: int  # of growth; 0 for a tiled layout
    numbers: dict[str, int]  # how many tiles of each counted kind it holds, by the settings' names
    repair: str  # a RepairStatus by name, "none" where nothing was repaired
    changed: int  # cells that the repair changed
    cpu_seconds: float  # of the repair
    # float [5, H, W], costs of moves (`guidance`); None where nothing draws them
    costs: np.ndarray | None = None
    drawing: str = ""  # `checksum` of the layout before its repair


def details(sized: Sized) -> dict[str, int | float | str]:
    """Return the numbers of a layout for tables and files."""
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


def parse_size(size: Any) -> tuple[int, int]:
    """Read a size like "57x58" (rows x columns) or (57, 58); raise InputError if it is none."""
    text = "x".join(map(str, size)) if isinstance(size, tuple | list) else str(size)
    numbers = re.fullmatch(r"(0?[1-9]\d{0,8})x(0?[1-9]\d{0,8})", text)
    if not numbers:
        raise InputError(f"size {size!r}: give rows and columns like 57x58")
    return int(numbers[1]), int(numbers[2])


def grow_series(
    config: EvaluationConfig, domain: Domain, solution: np.ndarray, steps: Sequence[int]
) -> list[np.ndarray]:
    """Grow a solution (float32 [P]) to framed layouts (int8 [H, W]), one for each number of steps.

    Raises InputError if the canvas is smaller than the seed block or the frame, or the solution is
    one of another architecture, or a number of steps is negative.
    """
    check_range("steps", tuple(steps), tuple[NonNegativeInt, ...])
    generator, grow = _generator(config.generator, domain.config)
    if solution.shape != (generator.size,):
        raise InputError(
            "this run searched tiles, not automata: its layouts have the size of the run alone"
            if generator.choices
            else f"{len(solution)} parameters given, this generator has {generator.size}"
        )
    return [np.asarray(grow(solution, np.int32(number))) for number in steps]


@lru_cache(maxsize=16)
def _generator(config: Any, domain: Any) -> tuple[Generator, Callable[..., jax.Array]]:
    """Make a generator for a domain of these settings, and jit its growth of one layout."""
    made = make_domain(domain)
    generator = GENERATORS.make(config, made.canvas)
    # As a population of one, the very way layouts grow during a search.
    return generator, jax.jit(lambda one, steps: made.frame(generator.grow(one[None], steps)[0]))


def grow_elite(
    run: RunDirectory,
    which: str | Sequence[int] | Elite = "best",
    shape: tuple[int | None, int | None] = (None, None),
    steps: int | None = None,
    numbers: Mapping[str, int] | None = None,
    keep: Keep | None = None,
    plan: Plan | None = None,
) -> Unrepaired:
    """Grow an elite of a run at any size; nothing is repaired yet.

    `which` is an elite, "best", or its cell's indices: "12,40" or (12, 40). `shape` is (rows,
    columns) of the framed layout, None for the trained ones. Steps of growth, and exact `numbers`
    of tiles by the settings' names, are those known of the size unless given, or else scaled up
    with the sides and the generated area. `keep` says what must stay (`keep_from`), at the trained
    size beside what the run kept. A `plan` gives its size, its numbers and its rules. Raises
    InputError if there is no such elite, the size is impossible, or what must stay is.
    """
    config = run.config.evaluation
    trained = make_domain(config.domain)
    if plan is None:
        rows, cols = shape[0] or trained.shape[0], shape[1] or trained.shape[1]
        domain = trained.resized(rows, cols, numbers)
        domain = domain if keep is None else keep_from(keep, domain)
        domain.demand_plan()
    else:
        domain, (rows, cols) = plan.fitted(numbers, keep), plan.layout.shape
        if shape not in ((None, None), (rows, cols)):
            raise InputError(f"{plan.name} is {rows} x {cols}: leave rows and cols out")
        if domain.generated != trained.generated:
            own = f"{domain.name} has {domain.generated}"
            raise InputError(f"{run} draws {trained.generated}, {own}")
    if steps is None:
        size = trained.known_size(rows, cols)
        own = GENERATORS.make(config.generator, trained.canvas).steps
        # A larger canvas grows out of the same seed, a few cells per step.
        longer = max(rows / trained.shape[0], cols / trained.shape[1], 1)
        steps = size.steps if size and own else round(own * longer)
    elite = which if isinstance(which, Elite) else run.archive.elite(which)
    layout = grow_series(config, domain, elite.solution, [steps])[0]
    if plan is None and keep is None and getattr(config.generator, "arithmetic", "") == "exact":
        recorded = run.shipped.drawing(elite.cell, (rows, cols), steps) if run.shipped else ""
        if (rows, cols, steps) == (*elite.unrepaired.shape, config.generator.steps):
            recorded = recorded or checksum(elite.unrepaired)
        if recorded not in ("", checksum(layout)):
            _LOG.warning(_OTHER_DRAWING, run, rows, cols, checksum(layout), recorded)
    same = domain.config == trained.config and np.array_equal(layout, elite.unrepaired)
    how = config.repair if same else replace(config.repair, polish="full")
    return Unrepaired(domain, elite, layout, steps, how)


def repair_grown(grown: Unrepaired, seed: int = 0, progress: Progress = silent) -> Repair | None:
    """Repair a grown layout; None where its domain has no rules.

    Raises InputError if no layout of this size obeys the rules, or none was found.
    """
    domain = grown.domain
    if domain.rules is None:
        return None
    # These import a compiler and a solver.
    from qdenv.repairs.milp.feasibility import explain
    from qdenv.repairs.recipe import repair_layout

    rules = domain.rules()
    result = repair_layout(grown.layout, rules, seed, grown.repair, progress)
    if result.status >= RepairStatus.IMPOSSIBLE:
        rows, cols = domain.shape
        demanded = "".join(f" with {number} {name}" for name, number in domain.numbers.items())
        reason = explain(rules, progress) or "none was found, try another repair seed"
        raise InputError(f"no repair of {rows} x {cols}{demanded}: {reason}")
    return result


def draw_grown_costs(
    config: EvaluationConfig, grown: Unrepaired, layout: np.ndarray
) -> np.ndarray | None:
    """Draw the costs of moves on what a grown layout was repaired into (int8 [H, W]).

    Returns float [5, H, W] (`guidance`), or None where the generator draws none.
    """
    generator = config.generator
    if hasattr(generator, "steps"):
        generator = replace(generator, steps=grown.steps)
    draw = make_costs_drawer(replace(config, generator=generator), grown.domain)
    if draw is None or grown.elite is None:
        return None
    costs = draw(grown.elite.solution[None], layout[None])[0]
    return unscaled_costs(costs, grown.domain.drivable(layout))


def finish(grown: Unrepaired, seed: int) -> Sized:
    """Repair a layout and count what that changed; raise InputError as `repair_grown` does."""
    before, repaired = grown.layout, repair_grown(grown, seed)
    after = before if repaired is None else np.asarray(repaired.layout)
    return Sized(
        layout=after,
        steps=grown.steps,
        numbers=grown.domain.fitted(after).numbers,
        repair="none" if repaired is None else RepairStatus(int(repaired.status)).name.lower(),
        changed=int((before != after).sum()),
        cpu_seconds=0.0 if repaired is None else round(float(repaired.seconds), 3),
        drawing=checksum(before),
    )


def grow_sizes(
    run: RunDirectory,
    which: str = "best",
    sizes: Sequence[tuple[int, int]] = SIZES,
    steps: Sequence[int] = (),
    numbers: Mapping[str, Sequence[int]] | None = None,
    seed: int | None = None,
    rules: Mapping[str, Any] | None = None,
) -> Iterator[Sized]:
    """Grow one elite at several sizes (rows, columns), and yield each layout when it is repaired.

    `which`, and `steps` and `numbers` for each size, are as in `grow_elite`; `seed` is that of the
    repair, the run's own unless given; `rules` are settings of aisles and racks. Raises InputError
    if there is no such elite, a size is impossible, or a list has another length than `sizes`.
    """
    given = {name: np.atleast_1d(one).tolist() for name, one in (numbers or {}).items()}
    steps = np.atleast_1d(steps).tolist()
    for name, values in {"steps": steps, **given}.items():
        if values and len(values) != len(sizes):
            raise InputError(f"{len(values)} numbers of {name} for {len(sizes)} sizes: give all")
    config = run.config
    seed = config.seed if seed is None else seed
    for index, shape in enumerate(sizes):
        own = {name: values[index] for name, values in given.items() if values} | dict(rules or {})
        grown = grow_elite(run, which, shape, steps[index] if steps else None, own)
        sized = finish(grown, seed)
        yield sized._replace(costs=draw_grown_costs(config.evaluation, grown, sized.layout))


def grow_frames(
    run: RunDirectory, grown: Unrepaired, every: int
) -> tuple[list[int], list[np.ndarray]]:
    """Grow an elite of a run once more and keep what it drew on the way (Figure 6).

    Return the multiples of `every` and the last step, and the unrepaired layout (int8 [H, W]) after
    each of these numbers of steps. Raises InputError if `every` is not positive, or no elite drew
    the layout.
    """
    check_range("every", every, PositiveInt)
    if grown.elite is None:
        raise InputError("a tiled layout did not grow: it has no frames")
    steps = sorted({*range(0, grown.steps, every), grown.steps})
    return steps, grow_series(run.config.evaluation, grown.domain, grown.elite.solution, steps)


def make_grower(config: EvaluationConfig, domain: Domain) -> tuple[int, Grower]:
    """Make the function that grows solutions at the trained size and keeps every step.

    Return the number of steps, 0 where nothing grows, and the function: float32 [B, P] -> framed
    layouts int8 [B, steps + 1, H, W]. Another B is compiled again.
    """
    generator = GENERATORS.make(config.generator, domain.canvas)
    steps = generator.steps

    @jax.jit
    def grow(solutions: jax.Array) -> jax.Array:
        if generator.frames is not None:
            frames = generator.frames(solutions, steps)
        else:  # a generator that gives nothing but the end is run once for each number of steps
            after = jnp.arange(steps + 1)
            frames = jax.lax.map(lambda step: generator.grow(solutions, step), after)
            frames = jnp.moveaxis(frames, 0, 1)
        return jnp.asarray(jax.vmap(jax.vmap(domain.frame))(frames))

    return steps, lambda solutions: np.asarray(grow(jnp.asarray(solutions)))


def make_costs_drawer(config: EvaluationConfig, domain: Domain) -> CostsDrawer | None:
    """Make the function that draws the costs of moves of elites; None if they have none.

    It maps solutions float32 [B, P] and their repaired layouts int8 [B, H, W] to costs
    int32 [B, 5, H, W]. The simulations of an update model are of one seed, not those of the search.
    Another B is compiled again.
    """
    generator = GENERATORS.make(config.generator, domain.canvas)
    if generator.guide is None:
        return None
    from qdenv.pipeline import draw_costs  # imports the whole chain

    def one(item: tuple[jax.Array, jax.Array]) -> jax.Array:
        return draw_costs(domain.simulator, generator, *item, key=jax.random.key(0))

    draw = jax.jit(lambda *items: jax.lax.map(one, items))
    return lambda solutions, layouts: np.asarray(draw(solutions, layouts))


def spread(cells: np.ndarray, first: int) -> Iterator[int]:
    """Order elites so that the first few of them, however many, lie evenly over the archive.

    Each is the one farthest from all before it (Gonzalez 1985, "Clustering to minimize the maximum
    intercluster distance", https://doi.org/10.1016/0304-3975(85)90224-5). `cells` is int
    [elites, M]; each of its rows is yielded once, beginning with the row `first`.
    """
    points = cells.astype(np.int32)
    distance = np.full(len(points), np.iinfo(np.int32).max)
    row = first
    for _ in range(len(points)):
        yield row
        np.minimum(distance, ((points - points[row]) ** 2).sum(axis=1), out=distance)
        distance[row] = -1  # never the farthest again
        row = int(distance.argmax())


def repeat(grid: Array, domain: Domain) -> np.ndarray:
    """Repeat what is inside the frame of a small grid (any [h, w]) over that of a larger layout.

    The copies start in the upper left corner; those at the right and at the bottom are cut.
    `domain` is at the larger size. Raises InputError if the layout is smaller than the frame.
    """
    inside, (height, width) = inside_frame(grid, domain.margin), domain.generated_shape
    if min(height, width) < 1 or inside.size == 0:
        rows, cols = domain.shape
        raise InputError(f"{rows} x {cols} leaves no room inside the frame: give a larger size")
    copies = -(-height // inside.shape[0]), -(-width // inside.shape[1])  # rounded up
    return np.tile(np.asarray(inside), copies)[:height, :width]


def tile(
    plan: Plan,
    shape: tuple[int, int],
    numbers: Mapping[str, int] | None = None,
    config: RepairConfig | None = None,
    seed: int = 0,
) -> Sized:
    """Tile a small plan to a larger shape and repair it, with its costs of moves (section E.4).

    The frame is drawn again. Numbers of tiles that are left out are those known of the size, or
    else the small layout's, scaled with the area. Raises InputError if the size is impossible, or
    no repair was found.
    """
    larger = plan.domain.fitted(plan.layout).resized(*shape, numbers)
    tiled = np.asarray(larger.frame(repeat(plan.layout, larger)))
    # Walls and stations are repeated, too.
    fitted = larger.fitted(tiled, larger.numbers | dict(numbers or {}))
    sized = finish(Unrepaired(fitted, None, tiled, 0, config or RepairConfig()), seed)
    rows, cols = larger.margin

    def adapt(grid: np.ndarray) -> np.ndarray:
        # No move begins in the frame.
        return np.pad(repeat(grid, larger), ((rows, rows), (cols, cols)))

    return sized._replace(costs=keep_costs(plan, sized.layout, adapt))
