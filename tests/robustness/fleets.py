"""Attack on the simulator: fleets of every kind on random layouts, each run recorded and audited.

Some are guided by costs of moves, some of which are one way. The goals that were drawn are compared
with their odds: of all attempts together, chi-square is about its degrees of freedom. A program is
compiled for a size and settings, so both come from a short list.
"""

import functools
import hashlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
from scipy import stats

import qdenv
from qdenv.grid import NUM_MOVES
from qdenv.guidance import fixed_costs
from qdenv.repairs.recipe import repair_layout
from qdenv.repairs.settings import RepairConfig
from qdenv.simulation.mapf.audit import audit
from qdenv.simulation.mapf.goals import check_playable
from qdenv.simulation.mapf.metrics import Recording
from qdenv.simulation.mapf.negotiated.settings import HIGH, LOW
from qdenv.study.engine import run_seeds
from qdenv.types import Floor, RepairStatus, TaskRule, Traffic
from robustness.campaign import Attack, Attempt

TILES, SHAPE = ".#ew", (12, 13)  # of layouts with random walls
STAYS = {"plain": (0, 0), "services": (0, 2, 11, 0)}  # timesteps at goals, e and w by turns
DOMAINS, DOMAIN_SHAPE = ("warehouse-even", "warehouse-uneven", "manufacturing"), (13, 16)
RULES = (*STAYS, *DOMAINS)
AGENTS, TIMESTEPS, RUNS = 60, 303, 4
DENSITY = (0.02, 0.75)  # share of the free cells with an agent
ONE_WAY = {"equal": 0.0, "guided": 0.0, "one-way": 0.2}  # costs -> share of moves not allowed
IMPROBABLE = 1e-9  # of the goals of an attempt, by their odds
XLA_SHARE = 0.25  # of the attempts that run in XLA as well


Planning = tuple[Any, int, int]  # settings of a planner, window, horizon
PLANNERS: dict[str, Planning] = {
    "low": (LOW, 10, 5),
    "high": (HIGH, 10, 5),
    "low, short": (LOW, 6, 4),
    "pibt": (qdenv.PibtConfig(), 10, 5),
    "pibt, swap": (qdenv.PibtConfig(swap=True), 10, 5),
    "plain": (qdenv.PbsConfig("plain", 0.5), 10, 5),
    "published": (qdenv.PbsConfig("published", 0.5), 10, 5),
    "published, long": (qdenv.PbsConfig("published", 0.5), 20, 7),
}


@functools.cache
def tasks_of(rule: str) -> TaskRule:
    """Return the tasks of a rule; programs are cached by this record."""
    if rule in DOMAINS:
        tasks = qdenv.find_domain(rule).resized(*DOMAIN_SHAPE).simulator.tasks
        assert tasks is not None
        return tasks
    goals = (qdenv.tile_goal("ew"[i % 2], TILES, stay) for i, stay in enumerate(STAYS[rule]))
    return TaskRule(TILES, ".ew", tuple(goals))


def random_layout(rng: np.random.Generator, walls: float) -> np.ndarray:
    """Draw a connected layout with both kinds of goal (int8 [12, 13])."""
    while True:
        layout = rng.choice(4, SHAPE, p=[0.8 - walls, walls, 0.12, 0.08]).astype(np.int8)
        try:
            check_playable(layout, tasks_of("plain"), 1)
        except qdenv.InputError:
            continue
        return layout


def random_costs(rng: np.random.Generator, free: np.ndarray, one_way: float) -> np.ndarray:
    """Draw costs of moves, some of them one way, by which all cells still reach all others."""
    while True:
        costs = rng.uniform(0.3, 3, (NUM_MOVES, *free.shape))
        costs[1:][rng.random(costs[1:].shape) < one_way] = np.inf
        try:
            fixed_costs(costs, free)
        except qdenv.InputError:
            one_way /= 2
            continue
        return costs


def draw_layout(rng: np.random.Generator, rule: str) -> np.ndarray:
    """Draw a layout (int8 [H, W]) with every goal: random walls, or a repaired one of a domain."""
    if rule not in DOMAINS:
        return random_layout(rng, rng.uniform(0, 0.35))
    domain = qdenv.find_domain(rule).resized(*DOMAIN_SHAPE)
    assert domain.rules is not None
    while True:
        odds = rng.dirichlet(np.ones(len(domain.generated)))
        inside = rng.choice(len(domain.generated), domain.generated_shape, p=odds)
        layout, seed = domain.frame(inside.astype(np.int8)), int(rng.integers(1 << 30))
        repair = repair_layout(np.asarray(layout), domain.rules(), seed, RepairConfig("none"))
        if int(repair.status) >= RepairStatus.IMPOSSIBLE:
            continue
        layout = np.asarray(repair.layout)
        try:
            check_playable(layout, tasks_of(rule), 1)
        except qdenv.InputError:
            continue
        return layout


def draw_costs(rng: np.random.Generator, layout: np.ndarray, tasks: TaskRule) -> tuple[str, Floor]:
    """Draw no costs of moves, or some by which all cells still reach all others."""
    kind = str(rng.choice(list(ONE_WAY), p=[0.5, 0.25, 0.25]))
    if kind == "equal":
        return kind, Floor(layout)
    free = np.isin(layout, [*map(tasks.tiles.index, tasks.traversable)])
    return kind, Floor(layout, fixed_costs(random_costs(rng, free, ONE_WAY[kind]), free))


def attempt(rng: np.random.Generator, folder: Path, kind: str = "") -> Attempt:
    """Simulate fleets of one planner on one floor, of a rule if it is given; audit every step."""
    rule = kind or str(rng.choice(RULES))
    layout, name = draw_layout(rng, rule), str(rng.choice(list(PLANNERS)))
    tasks, planning = tasks_of(rule), PLANNERS[name]
    costs, floor = draw_costs(rng, layout, tasks)
    free = int(np.isin(layout, [tasks.tiles.index(tile) for tile in tasks.traversable]).sum())
    least, most = DENSITY
    agents = int(np.clip(round((least + (most - least) * rng.random() ** 2) * free), 1, AGENTS))
    seeds = [int(seed) for seed in rng.integers(1 << 30, size=RUNS)]
    # Compiling in XLA takes long, so only one rule runs there.
    in_xla = hasattr(planning[0], "backend") and rule == "services"
    in_xla = in_xla and rng.random() < XLA_SHARE
    faults, steps, contents, flowing = [], 0, [], 0
    for backend in ("host", "xla")[: 1 + in_xla]:
        runs, draws = simulate(floor, tasks, planning, backend, agents, seeds)
        flowing += sum(int(run.end_timestep) * agents for run, _, _ in runs if not run.congested)
        steps += sum(int(run.end_timestep) * agents for run, _, _ in runs)
        contents.append([content for _, _, content in runs])
        about = f"{rule}, {name} ({backend}), {agents} agents"
        for seed, (_, broken, _) in zip(seeds, runs, strict=True):
            faults += [f"{about}, seed {seed}: {line}" for line in broken]
    for seed, *pair in zip(seeds, *contents, strict=True):
        if len(set(pair)) > 1:
            faults.append(f"{rule}, {name}, {agents} agents, seed {seed}: XLA differs")
    chi_square, freedom = compare_odds(layout, tasks, draws)
    if stats.chi2.sf(chi_square, freedom) < IMPROBABLE:
        faults.append(f"{rule}, {name}: goals with chi-square {chi_square:.0f} of {freedom}")
    notes = {"runs": RUNS * len(contents), "runs in both backends": RUNS * in_xla, name: RUNS}
    notes |= {f"steps in {rule} without jams": flowing, f"steps with {costs} costs": steps}
    if freedom:
        notes |= {"goals": sum(len(cells) for cells in draws)}
        notes |= {"chi-square": round(chi_square), "degrees of freedom": freedom}
    return Attempt(steps, faults, notes)


def compare_odds(layout: np.ndarray, tasks: TaskRule, draws: list[np.ndarray]) -> tuple[float, int]:
    """Return chi-square of the goals drawn (cells, for each kind) and its degrees of freedom."""
    total, freedom = 0.0, 0
    for goal, cells in zip(tasks.cycle, draws, strict=True):
        odds = np.asarray(goal.weight(layout), float).reshape(-1)
        places = np.flatnonzero(odds)
        expected = len(cells) * odds[places] / odds.sum()
        if expected.min() < 5:  # too few for chi-square to be of its distribution
            continue
        counts = np.bincount(cells, minlength=layout.size)[places]
        total += float(((counts - expected) ** 2 / expected).sum())
        freedom += len(places) - 1
    return total, freedom


def forbidden(floor: Floor, positions: np.ndarray) -> list[str]:
    """Return the first move against a one-way lane (positions int [t + 1, A])."""
    if floor.costs is None:
        return []
    width = floor.layout.shape[1]
    costs = floor.costs.reshape(NUM_MOVES, -1)
    for number, step in enumerate((0, 1, -1, width, -width)):
        moved = positions[1:] - positions[:-1] == step
        for time, agent in np.argwhere(moved & (costs[number][positions[:-1]] == 0))[:1]:
            return [f"t={time + 1}: agent {agent} makes a move that is not allowed"]
    return []


def simulate(
    floor: Floor, tasks: TaskRule, planning: Planning, backend: str, agents: int, seeds: list[int]
) -> tuple[list[tuple[Traffic, list[str], str]], list[np.ndarray]]:
    """Simulate once per seed: what was counted, the broken rules, a hash of the recording.

    Returns the cells of all goals that were drawn, for each kind, as well.
    """
    planner, window, horizon = planning
    if hasattr(planner, "backend"):
        planner = replace(planner, backend=backend)
    config = qdenv.FleetConfig(AGENTS, TIMESTEPS, window, horizon, planner, False)

    draws: list[list[np.ndarray]] = [[] for _ in tasks.cycle]

    def read(seed: int, run: Traffic, recording: Recording) -> tuple[Traffic, list[str], str]:
        end = int(run.end_timestep)
        positions, goals, finished = (
            np.asarray(part)[: end + 1, np.asarray(recording.active)]
            for part in (recording.positions, recording.goals, recording.finished)
        )
        broken = audit(floor.layout, tasks, recording, run, horizon)
        broken += forbidden(floor, positions)
        drawn = np.concatenate([np.ones_like(finished[:1]), finished[:end]])
        kinds = np.cumsum(drawn, axis=0) - 1
        for kind, cells in enumerate(draws):
            cells.append(goals[drawn & (kinds % len(draws) == kind)])
        content = hashlib.blake2b(digest_size=16)
        for leaf in jax.tree.leaves((run, recording)):
            content.update(np.ascontiguousarray(leaf).tobytes())
        return run, broken, content.hexdigest()

    readings = run_seeds(floor, tasks, config, seeds, agents, read=read, threads=1).readings
    return readings, [np.concatenate(cells) for cells in draws]


AUDITS = Attack(
    "audits",
    "no run breaks a rule of movement or service; goals have their odds; both backends agree",
    "agent-steps",
    attempt,
    RULES,
)
