"""Benchmarks of the simulators: fleets beside recorded runs, fleets over sizes, mazes."""

import json as json_format
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from statistics import mean, stdev
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

import qdenv
from experiments.benchmarks.common import Row, Stopwatch, best_of, save, show
from experiments.benchmarks.repair import grow_random, rules_at_size
from experiments.ledger import DRIVERS
from qdenv.agent.evaluate import default_horizon, draw_mazes, run_alone, run_batch
from qdenv.ranges import PositiveInt
from qdenv.repairs.recipe import repair_layout
from qdenv.simulation.maze.policy import Weights, draw_weights, load_weights
from qdenv.simulation.maze.world import longest_path
from qdenv.study.elites import parse_size
from qdenv.types import InputError
from qdenv.view.style import new_figure, save_figure

DOMAINS = {  # by their names in the file of recorded runs
    "warehouse_even": "warehouse-even",
    "warehouse_uneven": "warehouse-uneven",
    "manufacture": "manufacturing",
}
WINDOW = 5  # timesteps between two plans
# Layout, domain, tiles int8 [H, W], agents, timesteps, recorded runs.
Case = tuple[str, str, np.ndarray, int, int, list[Row]]


def simulate(
    reference: Path | None = None,
    layouts: Path | None = None,
    planners: tuple[Literal["low", "high", "published", "plain"], ...] = ("low", "high"),
    seeds: PositiveInt = 3,
    longest: int = 1000,
    match: str = "",
    audit: bool = False,
    json: Path | None = None,
) -> Row:
    """Simulate fleets beside recorded runs of the published C++ (RHCR: PBS and SIPP).

    Every recorded case (layout, domain, agents, T) is simulated with our seeds. Seeds are not
    paired: the two programs draw starts and goals differently. CPU seconds are those of one run;
    the reference's include its preprocessing, ours exclude compilation.

    Args:
        reference: file of recorded runs; without it, hand-made and grown layouts are simulated.
        layouts: folder of the recorded runs' layouts; beside the reference unless given.
        planners: the negotiated one at low or high effort, or priority-based search by the
            published or the plain rule.
        seeds: number of runs of each case.
        longest: leave out cases with a longer horizon T; the horizon of all our own cases.
        match: only layouts whose name contains this.
        audit: check every trajectory.
        json: file of the result.
    """
    cases = own_cases(longest)
    if reference:
        cases = recorded_cases(reference, layouts or reference.parent / "layouts", longest)
    chosen = [case for case in cases if match in case[0]]
    if not chosen:
        raise qdenv.InputError("no case is left to simulate")
    rows = (simulate_case(*pair, seeds, audit) for pair in product(chosen, planners))
    return save(json, fleets=show("fleets", rows))


def own_cases(timesteps: int) -> Iterator[Case]:
    """Yield the hand-made layout of size S of each domain, and a grown one of a fixed key."""
    for kind in DOMAINS.values():
        domain = qdenv.find_domain(kind)
        if domain.human is not None:
            yield f"{kind} human", kind, np.asarray(domain.human()), 200, timesteps, []
        repair = repair_layout(grow_random(kind, 1)[0], rules_at_size(kind))
        yield f"{kind} random", kind, np.asarray(repair.layout), 200, timesteps, []


def recorded_cases(reference: Path, layouts: Path, longest: int) -> Iterator[Case]:
    """Yield the cases of a file of recorded runs.

    Raises InputError if the file or one of its layouts cannot be read.
    """
    cases: dict[tuple, list[Row]] = {}
    try:
        for run in json_format.loads(reference.read_text())["records"]:
            case = run["layout"], DOMAINS[run["domain"]], run["n_agents"], run["T"]
            cases.setdefault(case, []).append(run)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise qdenv.InputError(f"{reference}: no file of recorded runs ({error!r})") from error
    for (name, kind, agents, timesteps), runs in cases.items():
        if timesteps > longest:
            print(f"{name}: left out, T {timesteps} is above --longest {longest}")
            continue
        tiles = qdenv.read_plan(layouts / name, kind).layout
        yield name, kind, tiles, agents, timesteps, runs


def simulate_case(case: Case, planner: str, seeds: int, audit: bool) -> Row:
    """Simulate a case with one planner, one run at a time: a row of the table."""
    name, kind, tiles, agents, timesteps, recorded = case
    options: Any = {"domain": kind, "timesteps": timesteps, "planner": DRIVERS[planner]}
    # Given one seed at a time, `simulate` uses one core: CPU seconds are then comparable.
    results = [
        qdenv.simulate(tiles, agents, audit, seeds=(seed,), **options) for seed in range(seeds)
    ]
    throughputs = [result["runs"][0]["throughput"] for result in results]
    row: Row = {
        "layout": name,
        "agents": agents,
        "T": timesteps,
        "planner": planner,
        "throughput": mean(throughputs),
        "error": stdev(throughputs) / seeds**0.5 if seeds > 1 else None,
        "congested": sum(result["runs"][0]["congested"] for result in results),
        "cpu_s": mean(result["cpu_seconds_per_run"] for result in results),
        "compile_s": results[0]["compile_seconds"],
        "broken": sum(len(result["broken"]) for result in results) if audit else None,
        "throughputs": throughputs,
    }
    if recorded:
        row["C++"] = mean(run["throughput"] for run in recorded)
        row["C++ congested"] = sum(run["congested"] for run in recorded)
        row["C++ cpu_s"] = mean(run["cpu_s"] for run in recorded)
        row["ratio"] = row["throughput"] / row["C++"] if row["C++"] else None
        row["cpu ratio"] = row["C++ cpu_s"] / row["cpu_s"]
    return row


# Columns whose slopes are fitted and drawn, with colours that colour-blind people can tell apart.
TIMED = {"growth": "#0072b2", "repair": "#d55e00", "distances": "#009e73", "window": "#cc79a7"}


def scale(
    sizes: tuple[str, ...] = ("33x36", "51x52", "101x102", "201x202", "401x401"),
    run: str = "zoo:warehouse-even",
    density: float = 10_000 / 401**2,
    timesteps: int = 200,
    effort: Literal["low", "high"] = "low",
    audit: bool = False,
    plot: Path | None = None,
    json: Path | None = None,
) -> Row:
    """Grow, repair and simulate layouts of one automaton at several sizes and time each step.

    CPU seconds of the growth, of the repair, of the first distances of a fleet and of a window of
    planning and driving; compilation is left out. In a log-log plot a cost proportional to the
    number of cells has slope 1.

    Args:
        sizes: rows x columns, the frame included.
        run: folder of a run, or zoo:DOMAIN/NAME, whose elite grows the layouts.
        density: agents per cell of the layout, walls included.
        timesteps: of the simulation.
        effort: of the planner.
        audit: check every step of the whole simulation.
        plot: file of a log-log plot with the slopes.
        json: file of the result.
    """
    if timesteps <= WINDOW:
        raise InputError(f"timesteps must be above {WINDOW}, those of one plan, not {timesteps}")
    shapes = [parse_size(size) for size in sizes]
    directory = qdenv.RunDirectory.open(run)
    config = directory.config.evaluation
    trained = qdenv.make_domain(config.domain)
    parameters = jnp.asarray(directory.archive.elite("best").solution)[None]

    def measure(shape: tuple[int, int]) -> Row:
        domain = trained.resized(*shape)
        # Cells grow out of a seed, one per step: a larger canvas needs as many more.
        steps = round(config.generator.steps * max(shape) / max(trained.shape))
        generator = replace(config.generator, steps=steps)
        pipeline = qdenv.make_pipeline(replace(config, domain=domain.config, generator=generator))
        grow = jax.jit(pipeline.grow).lower(parameters).compile()
        with Stopwatch() as growth:
            (layout,) = np.asarray(grow(parameters))
        assert domain.rules is not None
        repair = repair_layout(layout, domain.rules(), 0, config.repair)
        agents = max(round(density * layout.size), 1)
        options: Row = {"domain": domain.name, "seeds": (0,), "effort": effort, "stop": False}
        simulate = partial(qdenv.simulate, np.asarray(repair.layout), agents, **options)
        first = simulate(timesteps=WINDOW)["cpu_seconds_per_run"]
        whole = simulate(timesteps=timesteps, audit=audit)
        windows, seconds = timesteps / WINDOW, whole["cpu_seconds_per_run"]
        window = (seconds - first) / (windows - 1)
        return {
            "size": f"{shape[0]}x{shape[1]}",
            "cells": layout.size,
            "agents": agents,
            "growth": growth.cpu,
            "repair": float(repair.seconds),
            "changes": float(repair.cost),
            # Every agent looks up the distances to its first goal in the first window.
            "distances": max(first - window, 0.0),
            "window": window,
            "us per agent": 1e6 * seconds / windows / agents,
            "tasks/step": whole["mean_of_all"],
            "congested": whole["runs"][0]["congested"],
            "broken": len(whole["broken"]) if audit else None,
        }

    measure(shapes[0])  # compiles what all sizes share
    rows = show("sizes, CPU seconds", map(measure, shapes))
    slopes = {}
    if len(rows) > 1:  # exponents of the costs over the cells: least squares, log over log
        cells = np.log([row["cells"] for row in rows])
        costs = {name: np.log([max(row[name], 1e-9) for row in rows]) for name in TIMED}
        slopes = {name: float(np.polyfit(cells, cost, 1)[0]) for name, cost in costs.items()}
    print("slopes over the cells:", {name: round(value, 2) for name, value in slopes.items()})
    if plot:
        save_figure(draw(rows, slopes), plot)
    return save(json, sizes=rows, slopes=[slopes])


def draw(rows: list[Row], slopes: dict[str, float]) -> Figure:
    """Draw CPU seconds over cells, log over log, with the slopes in the legend."""
    figure = new_figure(6, 4.5)
    axes, cells = figure.subplots(), [row["cells"] for row in rows]
    for name, colour in TIMED.items():
        label = f"{name}, slope {slopes[name]:.2f}" if name in slopes else name
        axes.plot(cells, [row[name] or np.nan for row in rows], "o-", color=colour, label=label)
    axes.set(xscale="log", yscale="log", xlabel="cells of the layout", ylabel="CPU seconds")
    axes.set_xticks(cells, [row["size"] for row in rows])
    axes.minorticks_off()
    axes.grid(alpha=0.3)
    axes.legend(frameon=False, loc="lower right")
    axes.set_title(f"{rows[0]['agents']} to {rows[-1]['agents']} agents, one per equal area")
    return figure


def _layouts(seed: int, count: int, walls: int) -> np.ndarray:
    """Draw random mazes (int8 [count, 16, 16])."""
    return np.array([maze.layout for maze in draw_mazes(seed, count, (16, 16), walls)])


def pad_units(weights: Weights, units: int) -> Weights:
    """Add LSTM units that stay at zero: an agent of any size that decides as before."""
    missing = units - weights.actor.shape[0]
    more, rows = ((0, 0), (0, missing)), ((0, missing), (0, 0))

    def gates(matrix: Any) -> jax.Array:
        parts = [jnp.pad(part, more) for part in jnp.split(matrix, 4, axis=1)]
        return jnp.concatenate(parts, axis=1)

    return weights._replace(
        gates_in=gates(weights.gates_in),
        gates_back=jnp.pad(gates(weights.gates_back), rows),
        gates_bias=gates(weights.gates_bias[None])[0],
        actor=jnp.pad(weights.actor, rows),
        critic=jnp.pad(weights.critic, rows),
    )


def maze(
    units: int = 256,
    mazes: int = 12,
    repeats: PositiveInt = 3,
    large: bool = True,
    seed: int = 0,
    json: Path | None = None,
) -> Row:
    """Time the evaluation of random mazes of 90 walls; measure the shipped agent's success.

    An untrained agent nearly always runs to the horizon: its rows are the most that an evaluation
    can cost. The shipped agent with its LSTM padded to `units` decides as before and costs what a
    trained agent of that size costs. For one thread set XLA_FLAGS to
    "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1".

    Args:
        units: LSTM units of the untrained agent, 7 actions as published.
        mazes: number of 16 x 16 mazes of a batch.
        repeats: number of timed calls.
        large: also time a 64 x 64 maze with 100 episodes.
        seed: of the mazes and weights.
        json: file of the result.
    """
    shipped = jax.tree.map(jnp.asarray, load_weights())
    agents = {
        "untrained": draw_weights(jax.random.key(seed), units, 7),
        "padded": pad_units(shipped, units),
        "shipped": shipped,
    }
    batch = jnp.asarray(_layouts(seed, mazes, 90))
    big = jnp.asarray(draw_mazes(seed, 1, (64, 64), 1440)[0].layout)
    episodes, horizon, big_horizon = 50, 648, default_horizon(big)

    def in_line(weights: Any, batch: jax.Array, key: jax.Array) -> Any:
        evaluate = partial(run_alone, weights, episodes=episodes, horizon=horizon)
        return jax.lax.map(lambda item: evaluate(*item), (batch, jax.random.split(key, mazes)))

    together = jax.jit(partial(run_batch, episodes=episodes, horizon=horizon))
    one_by_one = jax.jit(in_line)
    once = jax.jit(partial(run_alone, episodes=episodes, horizon=horizon))
    alone = jax.jit(partial(run_alone, episodes=100, horizon=big_horizon))
    paths = jax.jit(jax.vmap(longest_path))

    def rows() -> Iterator[Row]:
        key, big_key = jax.random.key(1), jax.random.key(seed)
        for name, weights in agents.items():
            for way, call in (("batch", together), ("one by one", one_by_one)):
                timing = best_of(repeats, partial(call, weights, batch, key), mazes)
                yield {"per maze": f"{name} agent, {way}", **timing}
            if large:
                timing = best_of(1, partial(alone, weights, big, big_key))
                yield {"per maze": f"{name} agent, 64 x 64", **timing}
        yield {"per maze": "longest path", **best_of(repeats, partial(paths, batch), mazes)}

    def success(walls: int) -> Row:
        layouts = _layouts(seed + walls, 100, walls)
        runs = map(partial(once, shipped), layouts, jax.random.split(jax.random.key(0), 100))
        rates = [int(run.success.sum()) / episodes for run in runs]
        return {"walls": walls, "mean": mean(rates), "error": stdev(rates) / 10, "min": min(rates)}

    tables = {"timings": show(f"mazes, {units} units", rows())}
    tables["success"] = show("success of the shipped agent in 100 mazes", map(success, (60, 90)))
    return save(json, **tables)
