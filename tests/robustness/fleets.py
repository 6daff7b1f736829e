"""Attack on the simulator: fleets of every kind on random layouts, each run recorded and audited.

A program is compiled for a size and settings, so both come from a short list.
"""

import functools
import hashlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np

import qdenv
from qdenv.repair.recipe import repair_layout
from qdenv.repair.settings import RepairConfig
from qdenv.simulate.mapf.audit import audit
from qdenv.simulate.mapf.goals import check_playable
from qdenv.simulate.mapf.metrics import Recording
from qdenv.simulate.mapf.negotiated.settings import HIGH, LOW
from qdenv.study.engine import run_seeds
from qdenv.types import RepairStatus, TaskRule, Traffic
from robustness.campaign import Attack, Attempt

TILES, SHAPE = ".#ew", (12, 13)  # of layouts with random walls
STAYS = {"plain": (0, 0), "services": (0, 2, 11, 0)}  # timesteps at goals, e and w by turns
DOMAINS, DOMAIN_SHAPE = ("warehouse-even", "warehouse-uneven", "manufacturing"), (13, 16)
RULES = (*STAYS, *DOMAINS)
AGENTS, TIMESTEPS, RUNS = 60, 303, 4
DENSITY = (0.02, 0.75)  # share of the free cells with an agent
XLA_SHARE = 0.25  # of the attempts that run in XLA as well


Planning = tuple[Any, int, int]  # settings of a planner, window, horizon
PLANNERS: dict[str, Planning] = {
    "low": (LOW, 10, 5),
    "high": (HIGH, 10, 5),
    "low, short": (LOW, 6, 4),
    "pibt": (qdenv.PibtConfig(), 10, 5),
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


def draw_layout(rng: np.random.Generator, rule: str) -> np.ndarray:
    """Draw a layout (int8 [H, W]) with every goal: random walls, or a repaired one of a domain."""
    while True:
        if rule in DOMAINS:
            domain = qdenv.find_domain(rule).resized(*DOMAIN_SHAPE)
            assert domain.rules is not None
            odds = rng.dirichlet(np.ones(len(domain.generated)))
            inside = rng.choice(len(domain.generated), domain.generated_shape, p=odds)
            layout, seed = domain.frame(inside.astype(np.int8)), int(rng.integers(1 << 30))
            repair = repair_layout(np.asarray(layout), domain.rules(), seed, RepairConfig("none"))
            if int(repair.status) >= RepairStatus.IMPOSSIBLE:
                continue
            layout = np.asarray(repair.layout)
        else:
            walls = rng.uniform(0, 0.35)
            drawn = rng.choice(4, SHAPE, p=[0.8 - walls, walls, 0.12, 0.08])
            layout = drawn.astype(np.int8)
        try:
            check_playable(layout, tasks_of(rule), 1)
        except qdenv.InputError:
            continue
        return layout


def attempt(rng: np.random.Generator, folder: Path) -> Attempt:
    """Simulate fleets of one planner on one layout and audit every step."""
    rule = str(rng.choice(RULES))
    layout, name = draw_layout(rng, rule), str(rng.choice(list(PLANNERS)))
    tasks, planning = tasks_of(rule), PLANNERS[name]
    free = int(np.isin(layout, [tasks.tiles.index(tile) for tile in tasks.traversable]).sum())
    agents = int(np.clip(round(rng.uniform(*DENSITY) * free), 1, AGENTS))
    seeds = [int(seed) for seed in rng.integers(1 << 30, size=RUNS)]
    # Compiling in XLA takes long, so only one rule runs there.
    in_xla = hasattr(planning[0], "backend") and rule == "services"
    in_xla = in_xla and rng.random() < XLA_SHARE
    faults, steps, contents = [], 0, []
    for backend in ("host", "xla")[: 1 + in_xla]:
        runs = simulate(layout, tasks, planning, backend, agents, seeds)
        steps += sum(int(run.end_timestep) * agents for run, _, _ in runs)
        contents.append([content for _, _, content in runs])
        about = f"{rule}, {name} ({backend}), {agents} agents"
        for seed, (_, broken, _) in zip(seeds, runs, strict=True):
            faults += [f"{about}, seed {seed}: {line}" for line in broken]
    for seed, *pair in zip(seeds, *contents, strict=True):
        if len(set(pair)) > 1:
            faults.append(f"{rule}, {name}, {agents} agents, seed {seed}: XLA differs")
    notes = {"runs": RUNS * len(contents), "runs in both backends": RUNS * in_xla, name: RUNS}
    return Attempt(steps, faults, notes)


def simulate(
    layout: np.ndarray,
    tasks: TaskRule,
    planning: Planning,
    backend: str,
    agents: int,
    seeds: list[int],
) -> list[tuple[Traffic, list[str], str]]:
    """Simulate once per seed: what was counted, the broken rules, a hash of the recording."""
    planner, window, horizon = planning
    if hasattr(planner, "backend"):
        planner = replace(planner, backend=backend)
    config = qdenv.FleetConfig(AGENTS, TIMESTEPS, window, horizon, planner, False)

    def read(seed: int, run: Traffic, recording: Recording) -> tuple[Traffic, list[str], str]:
        broken = audit(layout, tasks, recording, run, horizon)
        content = hashlib.blake2b(digest_size=16)
        for leaf in jax.tree.leaves((run, recording)):
            content.update(np.ascontiguousarray(leaf).tobytes())
        return run, broken, content.hexdigest()

    return run_seeds(layout, tasks, config, seeds, agents, read=read, threads=1).readings


AUDITS = Attack(
    "audits",
    "no run breaks a rule of movement or service; both backends agree bit for bit",
    "agent-steps",
    attempt,
)
