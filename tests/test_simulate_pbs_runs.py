"""Whole runs under priority-based search: no rule is ever broken, and a run is one run."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import numpy as np
import pytest
from conftest import read_layout
from fleet_runs import PLAIN, SERVICES, give_little_room
from robustness.fleets import random_layout

from qdenv.domains.base import find_domain
from qdenv.simulation.mapf import fleet
from qdenv.simulation.mapf.audit import audit
from qdenv.simulation.mapf.metrics import Recording
from qdenv.simulation.mapf.pbs import planner as pbs_planner
from qdenv.simulation.mapf.pbs.workspace import Workspace, make_workspace
from qdenv.simulation.mapf.settings import PbsConfig
from qdenv.study.engine import run_seeds
from qdenv.types import TaskRule, Traffic

pytestmark = pytest.mark.slow

RULES = ("published", "plain")
SEEDS = (0, 1, 2)


def audited(
    layout: np.ndarray,
    tasks: TaskRule,
    config: fleet.FleetConfig,
    seeds: Sequence[int] = SEEDS,
    agents: int | None = None,
) -> list[Traffic]:
    """Run and audit; no message may come."""

    def read(seed: int, run: Traffic, recording: Recording) -> list[str]:
        return audit(layout, tasks, recording, run, config.horizon)

    done = run_seeds(layout, tasks, config, seeds, agents, read=read, threads=1)
    assert done.readings == [[]] * len(seeds)
    return done.runs


def kept_workspaces(monkeypatch) -> list[Workspace]:
    """Keep what the planner works on from here on."""
    works = []

    def make(*sizes: Any) -> Workspace:
        works.append(make_workspace(*sizes))
        return works[-1]

    monkeypatch.setattr(pbs_planner, "make_workspace", make)
    return works


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("name", ["warehouse-even", "warehouse-uneven", "manufacturing"])
def test_small_floors_of_every_domain_are_driven_by_the_rules(name, rule):
    domain = find_domain(name).resized(13, 16)
    config = fleet.FleetConfig(agents=24, timesteps=153, planner=PbsConfig(rule))
    runs = audited(domain.human(), domain.simulator.tasks, config)
    assert all(run.finished.sum() > 24 for run in runs)


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("nodes_per_agent", [0, 0.1, 2])
def test_crowds_break_no_rule_where_windows_stay_unsolved(nodes_per_agent, rule, monkeypatch):
    """Up to two agents on three free cells, and stays longer than the window."""
    planner, works = PbsConfig(rule, nodes_per_agent), kept_workspaces(monkeypatch)
    config = fleet.FleetConfig(agents=90, timesteps=63, planner=planner, stop_when_congested=False)
    for seed in SEEDS:
        layout = random_layout(np.random.default_rng(seed), 0.1 * (seed + 1))
        agents = int((0.15 + 0.25 * seed) * (layout != 1).sum())
        tasks = SERVICES if seed else PLAIN
        (run,) = audited(layout, tasks, config, (seed,), agents)
        assert run.finished.sum() > 0 and run.end_timestep == 63
    unsolved = sum(work.numbers.unsolved for work in works)
    windows = 3 * 13
    assert unsolved == windows if nodes_per_agent < 1 else 0 < unsolved < windows


@pytest.mark.parametrize("rule", RULES)
def test_a_run_is_the_same_recorded_or_not_inside_a_program_or_outside_alone_or_in_a_batch(rule):
    layout = random_layout(np.random.default_rng(5), 0.2)
    config = fleet.FleetConfig(agents=40, timesteps=63, planner=PbsConfig(rule))
    world = fleet.prepare(layout, SERVICES, config)
    on_host = jax.tree.map(np.asarray, world)
    keys = jax.vmap(jax.random.key)(np.arange(3))
    batch = jax.jit(jax.vmap(lambda key: fleet.record(world, key, config, 37)))(keys)
    simulate = jax.jit(lambda key: fleet.simulate(world, key, config, 37))
    outside_run = fleet.compile_runs(on_host, config, keep=True)
    for number, key in enumerate(keys):
        together, tape = jax.tree.map(lambda leaf, at=number: np.asarray(leaf[at]), batch)
        counted = simulate(key)
        outside, outside_tape = outside_run(on_host, number, 37)
        jax.tree.map(np.testing.assert_array_equal, outside, counted)
        jax.tree.map(np.testing.assert_array_equal, outside_tape, tape)
        jax.tree.map(partial(np.testing.assert_allclose, atol=1e-6), outside, together)
        assert counted.finished.sum() > 0
    starts = batch[1].positions[:, 0]
    assert not (starts[0] == starts[1]).all(), "seeds share no starts"


def test_the_rules_and_their_limits_are_different_planners():
    """Else the tests above would try one planner again and again."""
    layout = random_layout(np.random.default_rng(7), 0.2)
    config = fleet.FleetConfig(agents=50, timesteps=63, stop_when_congested=False)
    planners = [PbsConfig(), PbsConfig("plain"), PbsConfig("plain", 0)]
    runs = [
        run_seeds(layout, PLAIN, replace(config, planner=planner), (0,)).runs[0]
        for planner in planners
    ]
    usages = {run.usage.tobytes() for run in runs}
    assert len(usages) == len(planners)


@pytest.mark.parametrize(
    ("name", "domain"),
    [("warehouse_even_nca_a5", "warehouse-even"), ("manufacturing_nca_a5", "manufacturing")],
)
def test_200_agents_on_a_published_layout_break_no_rule(name, domain, published):
    tasks = find_domain(domain).simulator.tasks
    layout = read_layout(published(name), find_domain(domain).tiles)
    config = fleet.FleetConfig(agents=200, timesteps=100, planner=PbsConfig())
    (run,) = audited(layout, tasks, config, (0,))
    assert not run.congested and run.throughput > 5


@pytest.mark.parametrize("rule", RULES)
def test_little_room_at_first_changes_nothing(rule, monkeypatch):
    """A window that lacks room, for its tree or for distances, is planned again with more."""
    layout = random_layout(np.random.default_rng(2), 0.2)
    config = fleet.FleetConfig(
        agents=60, timesteps=33, planner=PbsConfig(rule, 1), stop_when_congested=False
    )
    expected = run_seeds(layout, SERVICES, config, (0,)).runs[0]
    works, rooms = kept_workspaces(monkeypatch), give_little_room(monkeypatch)
    monkeypatch.setattr(pbs_planner, "FIRST_DEPTH", 1)
    found = run_seeds(layout, SERVICES, config, (0,)).runs[0]
    jax.tree.map(np.testing.assert_array_equal, found, expected)
    depths = [len(work.node) for work in works]
    assert max(depths) > 1 and depths[0] == 1 and rooms and expected.finished.sum() > 0
