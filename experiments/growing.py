"""What elites of a run are worth at other sizes: grown, repaired, simulated; each but once."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from experiments.ledger import Case, complete
from qdenv.domains.base import Domain, make_domain
from qdenv.io.files import tidy
from qdenv.pipeline import simulate_layouts
from qdenv.run.archive import SavedArchive
from qdenv.run.config import override, scale
from qdenv.run.directory import RunDirectory
from qdenv.shipped import Driven, GrownLayout
from qdenv.stats import sample_of
from qdenv.study import elites as sizes
from qdenv.study.options import parse_seeds
from qdenv.types import InputError

Cell: TypeAlias = tuple[int, ...]
Shape: TypeAlias = tuple[int, int]
NONE = "0"  # seeds: leave this planner out


@dataclass(frozen=True)
class Measuring:
    """What is simulated."""

    # rows and columns of layouts, like 33x36 101x102; the trained size and those that the domain
    # knows unless given
    sizes: tuple[str, ...] = ()
    timesteps: int = 5000  # horizon of what is reported of fleets
    seeds: str = "2"  # of each layout under our planner at high effort
    pbs_seeds: str = "1"  # of each under priority-based search; 0 leaves it out
    episodes: int = 100  # of the agent in each maze
    trial_timesteps: int = 1000  # horizon of a trial of a fleet, which has one seed


class Workshop:
    """Grows elites of one run and of further ones, and simulates their layouts."""

    def __init__(self, runs: Sequence[RunDirectory], measuring: Measuring, ledger: Path) -> None:
        """Simulate nothing yet; the first run is the one whose settings are reported.

        Raises InputError if runs were evaluated in different ways.
        """
        (self.run, *self.further), self.measuring, self.ledger = runs, measuring, ledger
        self.config = self.run.config
        for one in self.further:
            if one.config.evaluation != self.config.evaluation or one.measures != self.run.measures:
                raise InputError(f"{one}: its objectives mean something else than {self.run}'s")
        trained = make_domain(self.config.evaluation.domain)
        self.fleet = trained.simulator.tasks is not None
        asked = [sizes.parse_size(text) for text in measuring.sizes]
        self.shapes: list[Shape] = asked or [trained.shape, *trained.known]
        self._grown: dict[tuple[Cell, Shape], sizes.Sized | None] = {}
        self._walks: dict[Shape, Callable] = {}  # compiled once for each size

    @cached_property
    def archive(self) -> SavedArchive:
        """The runs' archive: the best elite of each cell."""
        first, *others = (one.archive for one in (self.run, *self.further))
        columns = {
            name: np.concatenate([values, *(one.columns[name] for one in others)])
            for name, values in first.columns.items()
        }
        order = np.lexsort((-columns["objective"], columns["index"]))  # stable: the first run's
        firsts = order[np.unique(columns["index"][order], return_index=True)[1]]
        return replace(first, columns={name: values[firsts] for name, values in columns.items()})

    def at(self, shape: Shape) -> Domain:
        """Make the domain at a size, with all numbers that follow from it."""
        asked = override(self.config, {"rows": shape[0], "cols": shape[1]})
        return make_domain(scale(asked, self.config, ())[0].evaluation.domain)

    def grow(self, cell: Cell, shape: Shape) -> sizes.Sized | None:
        """Grow an elite and repair its layout as `qdenv generate` does; None where that fails."""
        if (cell, shape) not in self._grown:
            try:
                grown = sizes.grow_elite(self.run, self.archive.elite(cell), shape)
                found = sizes.finish(grown, self.config.seed)
            except InputError as error:
                print(f"{cell}: {error}")
                found = None
            self._grown[cell, shape] = found
        return self._grown[cell, shape]

    def worth(self, cell: Cell) -> float:
        """Try a layout of the last size: what it moves, or how often the agent arrives.

        -1 where it cannot be repaired, congests, or is never solved.
        """
        sized = self.grow(cell, self.shapes[-1])
        if sized is None:
            return -1.0
        if not self.fleet:
            return self.walk(sized.layout).success or -1.0
        trial = self.drive(cell, sized.layout, ("high", "1"), self.measuring.trial_timesteps)
        return trial.mean if trial.success == 1 else -1.0

    def flows(self, cell: Cell) -> bool:
        """Return True if a layout of the last size that is worth anything flows under PBS, too."""
        sized = self.grow(cell, self.shapes[-1])
        if sized is None or not self.fleet or self.measuring.pbs_seeds == NONE:
            return sized is not None
        plan = ("published", "1")
        return self.drive(cell, sized.layout, plan, self.measuring.timesteps).success == 1

    def measure(self, cell: Cell, shape: Shape) -> GrownLayout:
        """Grow a chosen elite at one size, and simulate it as is to be reported."""
        sized, how = self.grow(cell, shape), self.measuring
        assert sized is not None
        if self.fleet:
            plans = [("high", how.seeds), ("published", how.pbs_seeds)]
            plans = [plan for plan in plans if plan[1] != NONE]
            driven = [self.drive(cell, sized.layout, plan, how.timesteps) for plan in plans]
        else:
            driven = [self.walk(sized.layout)]
        measures = {
            axis.name: tidy(float(axis.value(jnp.asarray(sized.layout), None)))
            for axis in self.at(shape).measures
            if axis.value is not None and axis.limit != "timesteps"  # that needs simulations
        }
        exact = getattr(self.config.evaluation.generator, "arithmetic", "") == "exact"
        steps, numbers, repair, changed = sized[1:5]
        found = GrownLayout(*shape, steps, numbers, repair, changed, measures, tuple(driven))
        return replace(found, drawing=sized.drawing if exact else "")

    def drive(
        self, cell: Cell, layout: np.ndarray, plan: tuple[str, str], timesteps: int
    ) -> Driven:
        """Simulate a fleet on a layout (int8 [H, W]); `plan`: the planner's name, and seeds."""
        domain = self.at(layout.shape)
        agents = domain.config.fleet.agents
        name = f"{','.join(map(str, cell))} {layout.shape[0]}x{layout.shape[1]}"
        case = Case(name, layout, domain, agents, timesteps, plan[0])
        runs = complete(self.ledger, [case], parse_seeds(plan[1]))
        values = np.array([run.throughput for run in runs])
        flowed = np.mean([not run.congested for run in runs])
        return make_row(plan[0], agents, timesteps, values, float(flowed))

    def walk(self, layout: np.ndarray) -> Driven:
        """Evaluate the agent in a maze (int8 [H, W])."""
        domain, keys = self.at(layout.shape), jax.random.split(jax.random.key(0), 1)
        episodes = self.measuring.episodes
        walk = self._walks.setdefault(
            layout.shape,
            jax.jit(lambda mazes: simulate_layouts(domain.simulator, mazes, keys, episodes)),
        )
        runs = jax.tree.map(np.asarray, walk(jnp.asarray(layout)[None]))
        lengths = runs.length.reshape(-1).astype(float)
        return make_row("agent", 1, domain.config.timesteps, lengths, float(runs.success.mean()))


def make_row(
    planner: str, agents: int, timesteps: int, values: np.ndarray, success: float
) -> Driven:
    """Condense the runs of one layout (values: float [runs])."""
    found = tidy([*sample_of(values)[:2], success])  # no error, a NaN, is null in files
    return Driven(planner, agents, timesteps, len(values), *found)
