"""Attack on the simulator: fleets of every kind on random layouts, each run recorded and audited.

What XLA compiles depends on size and settings alone, so both come from a short list: a program is
compiled once, and then driven on fresh layouts.
"""

import hashlib
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from qdenv.domains.base import find_domain
from qdenv.repair.recipe import repair_layout
from qdenv.repair.settings import RepairConfig
from qdenv.simulate.mapf.audit import audit, trajectory_of
from qdenv.simulate.mapf.fleet import FleetConfig
from qdenv.simulate.mapf.goals import check_playable, tile_goal
from qdenv.simulate.mapf.metrics import Recording
from qdenv.simulate.mapf.negotiated.settings import HIGH, LOW
from qdenv.simulate.mapf.pbs.settings import PbsConfig
from qdenv.simulate.mapf.pibt.settings import PibtConfig
from qdenv.study.engine import run_seeds
from qdenv.types import InputError, RepairStatus, TaskRule, Traffic
from robustness.attack import Attack, Attempt

TILES = ".#ew"
STAYS = {"plain": (0, 0), "services": (0, 2, 11, 0)}  # kinds of goal e and w by turns
SHAPE = (12, 13)
DOMAIN_SHAPE = (13, 16)
AGENTS, TIMESTEPS, RUNS = 60, 303, 4
SHARE = (0.02, 0.75)  # of the free cells that hold an agent
TWIN_SHARE = 0.25  # of the attempts that drive in XLA as well
TASKS = {
    name: TaskRule(
        TILES, ".ew", tuple(tile_goal("ew"[i % 2], TILES, stay) for i, stay in enumerate(stays))
    )
    for name, stays in STAYS.items()
}


class Drivers(NamedTuple):
    """A planner and how far it looks; compiled once."""

    host: Any  # its settings on the host
    xla: Any  # in XLA; None where it does not run there
    window: int = 10  # timesteps planned ahead
    horizon: int = 5  # timesteps driven before planning again


def _both(settings: Any, window: int = 10, horizon: int = 5) -> Drivers:
    """Pair both backends of a planner."""
    host, xla = (replace(settings, backend=backend) for backend in ("host", "xla"))
    return Drivers(host, xla, window, horizon)


DRIVERS = {
    "low": _both(LOW),
    "high": _both(HIGH),
    "low, short": _both(LOW, 6, 4),
    "pibt": _both(PibtConfig()),
    "plain": Drivers(PbsConfig("plain", 0.5), None),
    "published": Drivers(PbsConfig("published", 0.5), None),
    "published, long": Drivers(PbsConfig("published", 0.5), None, 20, 7),
}
DOMAINS = ("warehouse-even", "warehouse-uneven", "manufacturing")
NAMES = (*STAYS, *DOMAINS)


class Site(NamedTuple):
    """Where fleets drive."""

    name: str  # of the rule
    layout: np.ndarray  # int8 [H, W]
    tasks: TaskRule  # what the agents do


def draw_site(chance: np.random.Generator, name: str) -> Site:
    """Draw a layout of a task rule: of random walls and goals, or a repaired one of a domain."""
    while True:
        site = _draw_domain(chance, name) if name in DOMAINS else _draw_walls(chance, name)
        try:
            check_playable(site.layout, site.tasks, 1)
        except InputError:
            continue
        return site


def _draw_walls(chance: np.random.Generator, name: str) -> Site:
    """Draw walls and goals; the free cells may fall apart."""
    walls = chance.uniform(0, 0.35)
    odds = [0.8 - walls, walls, 0.12, 0.08]
    return Site(name, chance.choice(4, SHAPE, p=odds).astype(np.int8), TASKS[name])


def _draw_domain(chance: np.random.Generator, name: str) -> Site:
    """Draw tiles of a domain and repair them; the repair may fail."""
    domain = find_domain(name).resized(*DOMAIN_SHAPE)
    tasks, rules = domain.simulator.tasks, domain.rules
    assert tasks is not None and rules is not None  # of the three domains of fleets
    odds = chance.dirichlet(np.ones(len(domain.generated)))
    drawn = chance.choice(len(domain.generated), domain.generated_shape, p=odds).astype(np.int8)
    layout, seed = np.asarray(domain.frame(drawn)), int(chance.integers(1 << 30))
    done = repair_layout(layout, rules(), seed, RepairConfig("none"))
    if int(done.status) >= RepairStatus.IMPOSSIBLE:
        return _draw_domain(chance, name)
    return Site(name, np.asarray(done.layout), _tasks_of(name))


def _tasks_of(name: str) -> TaskRule:
    """Find the tasks of a domain, always the same record: programs are known by it."""
    if name not in TASKS:
        tasks = find_domain(name).resized(*DOMAIN_SHAPE).simulator.tasks
        assert tasks is not None
        TASKS[name] = tasks
    return TASKS[name]


def attempt(chance: np.random.Generator, folder: Path) -> Attempt:
    """Drive fleets of one planner on one layout and audit every step."""
    del folder
    name = str(chance.choice(NAMES))
    site, driver = draw_site(chance, name), str(chance.choice(list(DRIVERS)))
    drivers, free = DRIVERS[driver], _count_free(site)
    agents = int(np.clip(round(chance.uniform(*SHARE) * free), 1, AGENTS))
    seeds = [int(seed) for seed in chance.integers(1 << 30, size=RUNS)]
    # Compiling in XLA takes long, so only one rule is driven there.
    twin = drivers.xla is not None and name == "services" and chance.random() < TWIN_SHARE
    settings = [drivers.host, drivers.xla] if twin else [drivers.host]
    faults, read = [], [_drive(site, drivers, planner, agents, seeds) for planner in settings]
    for backend, runs in zip(("host", "xla"), read, strict=False):
        where = f"{name}, {driver} ({backend}), {agents} agents"
        faults += [
            f"{where}, seed {seed}: {broken}"
            for seed, run in zip(seeds, runs, strict=True)
            for broken in run.broken
        ]
    for seed, *pair in zip(seeds, *read, strict=True):
        if twin and pair[0].content != pair[1].content:
            faults.append(f"{name}, {driver}, {agents} agents, seed {seed}: XLA differs")
    steps = sum(run.steps for runs in read for run in runs)
    notes = {"runs": sum(map(len, read)), "runs in both backends": RUNS * twin, driver: RUNS}
    return Attempt(steps, tuple(faults), notes)


class Driven(NamedTuple):
    """What is kept of one run."""

    broken: list[str]  # what it did against the rules
    steps: int  # agent-steps
    content: str  # a hash of everything that was counted and recorded


def _drive(
    site: Site, drivers: Drivers, planner: Any, agents: int, seeds: list[int]
) -> list[Driven]:
    """Drive and audit a fleet once per seed."""
    config = FleetConfig(
        agents=AGENTS,
        timesteps=TIMESTEPS,
        window=drivers.window,
        horizon=drivers.horizon,
        planner=planner,
        stop_when_congested=False,
    )

    def read(seed: int, run: Traffic, recording: Recording) -> Driven:
        del seed
        broken = audit(site.layout, site.tasks, trajectory_of(recording), run, config.horizon)
        content = hashlib.blake2b(digest_size=16)
        for leaf in jax.tree.leaves((run, recording)):
            content.update(np.ascontiguousarray(leaf).tobytes())
        return Driven(broken, int(run.end_timestep) * agents, content.hexdigest())

    done = run_seeds(site.layout, site.tasks, config, seeds, agents, read=read, threads=1)
    return done.readings


def _count_free(site: Site) -> int:
    """Count the cells that agents drive on."""
    drives = [site.tasks.tiles.index(tile) for tile in site.tasks.traversable]
    return int(np.isin(site.layout, drives).sum())


AUDITS = Attack(
    "audits",
    "no run breaks a rule of movement or service; both backends agree bit for bit",
    "agent-steps",
    attempt,
)
