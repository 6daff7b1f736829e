"""Congestion: which plans jam a fleet, where, and what a jam does to a run."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fleet_runs import PLAIN, StandConfig, programs, run_audited
from robustness.fleets import TILES, random_layout

from qdenv.grid import parse
from qdenv.simulation.mapf import fleet
from qdenv.simulation.mapf.audit import audit
from qdenv.simulation.mapf.negotiated.settings import NegotiatedConfig

pytestmark = pytest.mark.slow


def test_a_planner_plugs_in_from_outside_and_a_jam_ends_the_run():
    config = fleet.FleetConfig(agents=20, timesteps=100, planner=StandConfig())
    layout = random_layout(np.random.default_rng(0), 0.2)
    traffic, _ = run_audited(programs(PLAIN, config), PLAIN, config, layout, 0, 20)
    assert traffic.congested
    assert traffic.end_timestep == config.horizon
    assert traffic.waiting == 1.0


@pytest.mark.parametrize("planner", [StandConfig(), NegotiatedConfig(last_resort="wait")])
def test_a_run_that_goes_on_says_when_it_congested_first(planner):
    """A crowd in a hall: the audit finds the jams on its own, and that the first one is told."""
    agents = int((HALL != 1).sum()) // 2
    config = fleet.FleetConfig(agents, 300, planner=planner, stop_when_congested=False)
    prepare, run = programs(PLAIN, config)
    layout = jnp.asarray(HALL.astype(np.int8))
    numbers = run(prepare(layout), jax.random.key(0), jnp.int32(agents))
    traffic, recording = jax.tree.map(np.asarray, numbers)
    assert traffic.congested and traffic.end_timestep == 300 > traffic.congested_at > 0
    assert audit(HALL, PLAIN, recording, traffic) == []
    late = traffic._replace(congested_at=traffic.congested_at + 5)
    (found,) = audit(HALL, PLAIN, recording, late)
    assert found.endswith(f"but congested at {traffic.congested_at + 5}")
    stopping = programs(PLAIN, replace(config, stop_when_congested=True))[1]
    ended, _ = stopping(prepare(layout), jax.random.key(0), jnp.int32(agents))
    assert ended.end_timestep == ended.congested_at == traffic.congested_at


# Every second goal is one of four workstations, and every second free cell holds an agent.
HALL = parse(
    [
        "....eeeeeee.eeeeeee.eeee",
        "....#######.#######.####",
        "....eeeeeee.eeeeeee.eeee",
        "....eeeeeee.eeeeeee.eeee",
        "....#######.#######.####",
        "w...eeeeeee.eeeeeee.eeee",
        "w...eeeeeee.eeeeeee.eeee",
        "w...#######.#######.####",
        "w...eeeeeee.eeeeeee.eeee",
        "....eeeeeee.eeeeeee.eeee",
        "....#######.#######.####",
        "....eeeeeee.eeeeeee.eeee",
    ],
    TILES,
)


@pytest.mark.parametrize("resort", ["pibt", "wait"])
def test_the_last_resort_decides_whether_a_hot_spot_congests(resort):
    agents = int((HALL != 1).sum()) // 2
    config = fleet.FleetConfig(
        agents=agents, timesteps=300, planner=NegotiatedConfig(last_resort=resort)
    )
    compiled = programs(PLAIN, config)
    runs = [
        run_audited(compiled, PLAIN, config, HALL.astype(np.int8), seed, agents)[0]
        for seed in range(3)
    ]
    if resort == "pibt":
        assert not any(run.congested for run in runs)
        assert min(float(run.throughput) for run in runs) > 2.0
    else:
        assert all(run.congested for run in runs)
