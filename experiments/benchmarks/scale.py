"""Benchmark of size: one automaton's layouts from 33 x 36 to 401 x 401, at one density of agents.

For every size: CPU seconds of the growth, of the repair, of the distances that a fleet asks for
first; CPU milliseconds of a window of planning and driving; memory. Everything is compiled on the
way, apart from what is timed. In a log-log picture a cost that grows with the cells alone is a
line of slope 1.
"""

import resource
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from experiments.benchmarks.scale_figure import save_scale
from qdenv.domains.base import Domain, find_domain, make_domain
from qdenv.generate import GENERATORS
from qdenv.io.files import write_json
from qdenv.nca import NcaConfig
from qdenv.pipeline import EvaluationConfig, canvas_of
from qdenv.repair.recipe import repair_layout
from qdenv.run.directory import RunDirectory
from qdenv.simulate.mapf.choosing import find_planner
from qdenv.simulate.mapf.fleet import FleetConfig
from qdenv.study.elites import find_elite, grow_series
from qdenv.study.engine import auditor, run_seeds
from qdenv.types import InputError, RepairStatus, TaskRule

SIZES = ("33x36", "51x52", "101x102", "201x202", "401x401")
TIMED = ("growth", "repair", "distances", "window")  # what the picture shows, with a slope each
DRAWN = 20  # random automata, of which the one with the most varied small layout is taken


@dataclass(frozen=True)
class Options:
    """What to measure."""

    sizes: tuple[str, ...] = SIZES  # rows x columns, the frame included
    domain: str = "warehouse-even"  # whose layouts, where no run is given
    # a run whose best elite draws the layouts; else a random automaton of a fixed key
    run: Path | None = None
    density: float = 10_000 / 401**2  # agents per cell of the layout, walls included
    timesteps: int = 200  # length of the timed simulation
    effort: str = "low"  # of the planner
    audit: bool = False  # check every step of every simulation, too


class Automaton(NamedTuple):
    """What draws the layouts."""

    config: EvaluationConfig  # how it grows
    domain: Domain  # at the size it was made for
    solution: np.ndarray  # float32 [P], its parameters


def run(
    options: Annotated[Options, tyro.conf.arg(name="")],
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
    plot: Path | None = None,
) -> dict[str, Any]:
    """Grow, repair and simulate one automaton's layouts of all sizes, and time each step.

    Args:
        options: what to measure.
        json_file: where to write the result.
        plot: where to draw it, log over log with the slopes.

    Raises:
        InputError: a size cannot be read, or no fleet drives in this domain.
    """
    automaton = trained(options.run) if options.run else random_automaton(options.domain)
    measure(automaton, parse_size(options.sizes[0]), options)  # compiles what is not timed
    print(
        "      size  agents  growth s  repair s  distances s  ms per window  us per agent  "
        "tasks/step  peak GB"
    )
    rows = []
    for size in options.sizes:
        rows.append(measure(automaton, parse_size(size), options))
        print(line(rows[-1]), flush=True)
    slopes = {name: slope(rows, name) for name in TIMED} if len(rows) > 1 else {}
    print("slopes over the cells:", {name: round(value, 2) for name, value in slopes.items()})
    result = {"device": jax.devices()[0].device_kind, "slopes": slopes, "rows": rows}
    if json_file:
        write_json(json_file, result)
    if plot:
        save_scale(plot, rows, slopes)
    return result


def parse_size(text: str) -> tuple[int, int]:
    """Read a size like "101x102".

    Raises:
        InputError: it is none.
    """
    rows, _, cols = text.partition("x")
    if not (rows.isdigit() and cols.isdigit()):
        raise InputError(f"size {text!r}: give rows and columns like 101x102")
    return int(rows), int(cols)


def trained(path: Path) -> Automaton:
    """Take the best elite of a run."""
    directory = RunDirectory(path)
    config = directory.config.evaluation
    return Automaton(config, make_domain(config.domain), find_elite(directory).solution)


def random_automaton(name: str) -> Automaton:
    """Draw automata with weights N(0, 0.2^2) and take the one that uses its tiles most evenly."""
    domain = find_domain(name)
    config = EvaluationConfig(domain.config, NcaConfig())
    size = GENERATORS.make(config.generator, canvas_of(domain)).size
    drawn = np.asarray(0.2 * jax.random.normal(jax.random.key(0), (DRAWN, size)))

    def variety(solution: np.ndarray) -> int:
        (layout,) = grow_series(config, domain, solution, [NcaConfig().steps])
        return int(np.sort(np.bincount(layout.ravel(), minlength=len(domain.tiles)))[-3:].min())

    return Automaton(config, domain, max(drawn, key=variety))


def measure(automaton: Automaton, shape: tuple[int, int], options: Options) -> dict[str, Any]:
    """Time every step at one size: a row of the table.

    Raises:
        InputError: no fleet drives in this domain, or the repair failed.
    """
    domain = automaton.domain.resized(*shape)
    layout, growth = grow(automaton, domain)
    tasks = domain.simulator.tasks
    if domain.rules is None or tasks is None:
        raise InputError("no fleet drives in this domain: choose another one")
    repaired = repair_layout(layout, domain.rules(), 0, automaton.config.repair)
    if repaired.status >= RepairStatus.IMPOSSIBLE:
        raise InputError(f"the layout of {shape} could not be repaired")
    row = {
        "rows": shape[0],
        "cols": shape[1],
        "cells": layout.size,
        "growth": growth,
        "repair": float(repaired.seconds),
        "changes": float(repaired.cost),
    }
    row |= drive(np.asarray(repaired.layout), tasks, options)
    return row | {"peak_gb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20}


def grow(automaton: Automaton, domain: Domain) -> tuple[np.ndarray, float]:
    """Grow the layout of one size; returns it and the CPU seconds, compilation left out."""
    generator = GENERATORS.make(automaton.config.generator, canvas_of(domain))
    solution = jnp.asarray(automaton.solution)[None]
    # A drawing spreads a cell per step: a larger canvas needs as many more (section E.3).
    steps = round(generator.steps * max(domain.shape) / max(automaton.domain.shape))
    draw = jax.jit(lambda number: domain.frame(generator.grow(solution, number)[0]))
    jax.block_until_ready(draw(jnp.int32(1)))
    began = time.process_time()
    layout = np.asarray(draw(jnp.int32(steps)))
    return layout, time.process_time() - began


def drive(layout: np.ndarray, tasks: TaskRule, options: Options) -> dict[str, Any]:
    """Time the first window of a simulation and those after it.

    What the first window costs beyond the others is taken for the distances: everybody asks for
    those to its first goal then.
    """
    agents = max(round(options.density * layout.size), 1)
    whole = FleetConfig(
        agents, options.timesteps, planner=find_planner(options.effort), stop_when_congested=False
    )
    first = FleetConfig(agents, whole.horizon, planner=whole.planner)
    begin = run_seeds(layout, tasks, first, (0,), threads=1)
    read = auditor(layout, tasks, whole) if options.audit else None
    done = run_seeds(layout, tasks, whole, (0,), read=read, threads=1)
    windows = -(-whole.timesteps // whole.horizon)
    later = (done.cpu_seconds - begin.cpu_seconds) / max(windows - 1, 1)
    return {
        "agents": agents,
        "distances": max(begin.cpu_seconds - later, 0.0),
        "window": later,
        "us_per_agent": 1e6 * done.cpu_seconds / windows / agents,
        "throughput": float(done.runs[0].throughput),
        "congested": bool(done.runs[0].congested),
        "broken": [rule for found in done.readings for rule in found] if read else None,
    }


def slope(rows: list[dict[str, Any]], name: str) -> float:
    """Fit the exponent with which a cost grows over the cells (least squares, log over log)."""
    cells, costs = (np.log([max(row[key], 1e-9) for row in rows]) for key in ("cells", name))
    return float(np.polyfit(cells, costs, 1)[0])


def line(row: dict[str, Any]) -> str:
    """Write a row of the table; "!" where the run congested or broke a rule."""
    size = f"{row['rows']}x{row['cols']}"
    marks = "!" * (row["congested"] + bool(row["broken"]))
    return (
        f"{size:>10s} {row['agents']:7d} {row['growth']:9.2f} {row['repair']:9.2f} "
        f"{row['distances']:12.3f} {1e3 * row['window']:14.2f} {row['us_per_agent']:13.2f} "
        f"{row['throughput']:11.2f} {row['peak_gb']:8.2f} {marks}"
    )
