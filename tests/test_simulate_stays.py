"""Stays that differ from cell to cell, and tasks that arrive at a rate, in all planners."""

import functools
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fleet_runs import programs

from qdenv.grid import of_tiles, parse
from qdenv.simulation.mapf import chance, fleet
from qdenv.simulation.mapf.audit import audit
from qdenv.simulation.mapf.environment import WAIT, Environment
from qdenv.simulation.mapf.goals import tile_goal
from qdenv.simulation.mapf.negotiated.settings import LOW
from qdenv.simulation.mapf.settings import PbsConfig, PibtConfig
from qdenv.types import Goal, TaskRule

TILES = ".#eio"
# Planned with services as short as a window, and far longer than one word of the search counts.
SHORT, LONG = 3, 47
TIMESTEPS = 220


def stay_of(layout):
    """Serve at `i` shortly and at `o` for long."""
    is_inbound = of_tiles(layout, "i", TILES)
    return SHORT * is_inbound + LONG * of_tiles(layout, "o", TILES)


STATION = Goal(lambda layout: of_tiles(layout, "io", TILES).astype(np.float32), stay_of, "station")
TASKS = TaskRule(TILES, ".eio", (tile_goal("e", TILES, 1), STATION))
PLANNERS = {
    "negotiated": (replace(LOW, backend="host"), replace(LOW, backend="xla")),
    "pibt": (PibtConfig("host"), PibtConfig("xla")),
    "pbs": (PbsConfig(),),
}
FLOOR = parse(["i.......o", ".e.e.e.e.", ".........", ".e.e.e.e.", "o.......i"], TILES)


@functools.cache
def compiled(settings, rate):
    """Compile runs of up to nine robots; every test has a layout of the same shape."""
    config = fleet.FleetConfig(9, TIMESTEPS, planner=settings, stop_when_congested=False)
    return programs(TASKS._replace(rate=rate), config)


def outcomes(planner, layout, agents, seed=0, rate=0.0):
    """Simulate with each backend of a planner, audited."""
    for settings in PLANNERS[planner]:
        prepare, run = compiled(settings, rate)
        outcome = run(prepare(jnp.asarray(layout)), jax.random.key(seed), jnp.int32(agents))
        traffic, recording = jax.tree.map(np.asarray, outcome)
        assert audit(layout, TASKS._replace(rate=rate), recording, traffic) == []
        yield traffic, recording


@pytest.mark.slow
@pytest.mark.parametrize("planner", PLANNERS)
def test_one_robot_stays_as_long_as_its_station_says(planner):
    """On a line, every leg takes its distance and its stay: a closed form of the task times."""
    for station, stay in (("i", SHORT), ("o", LONG)):
        layout = parse([f"e.......{station}", *["#########"] * 4], TILES)
        for traffic, recording in outcomes(planner, layout, 1):
            begin = max(int(recording.positions[0, 0]), 1)  # being there takes one step, too
            times = np.cumsum([begin + 1] + [8 + stay, 8 + 1] * 20)
            ends = np.flatnonzero(traffic.finished) + 1
            np.testing.assert_array_equal(ends, times[times <= TIMESTEPS])


@pytest.mark.parametrize("planner", PLANNERS)
def test_backends_agree_on_stays_of_their_own(planner):
    for seed in range(2):
        first, *others = outcomes(planner, FLOOR, 9, seed)
        assert first[0].finished.sum() > 30
        for other in others:
            jax.tree.map(np.testing.assert_array_equal, first, other)
        # The longest services that were begun are those of the stations' kinds.
        left, goals = first[1].remaining_service[1:], first[1].goals[:-1]
        for symbol, stay in (("i", SHORT), ("o", LONG), ("e", 1)):
            assert left[(FLOOR.reshape(-1) == TILES.index(symbol))[goals]].max() == stay


@pytest.mark.slow
@pytest.mark.parametrize("planner", PLANNERS)
def test_backends_hand_out_the_same_orders_and_idle_robots_stand(planner):
    rate = 0.16
    for seed in range(2):
        first, *others = outcomes(planner, FLOOR, 9, seed, rate)
        for other in others:
            jax.tree.map(np.testing.assert_array_equal, first, other)
        traffic, tape = first
        idle = tape.goals[:-1] < 0
        assert traffic.finished.sum() == pytest.approx(rate * TIMESTEPS, rel=0.5)
        assert 0.2 < traffic.idle < 0.8 and idle[0].all() and traffic.order_wait < 20
        assert not traffic.congested, "who is idle is not stuck"
        still = tape.positions[1:] == tape.positions[:-1]
        assert still[idle].mean() > 0.7
    rule = TASKS._replace(rate=rate)
    for change, words in (
        ({"goals": np.where(tape.goals < 0, 9, tape.goals)}, "goal of another kind"),
        ({"positions": tape.positions[::-1]}, "credited"),
        ({"finished": tape.finished | idle}, "credited wrongly"),
    ):
        broken = audit(FLOOR, rule, tape._replace(**change), traffic)
        assert any(words in one for one in broken), (words, broken)
    assert any("another kind" in one for one in audit(FLOOR, TASKS, tape, traffic))
    broken = audit(FLOOR, rule, tape, traffic._replace(idle=np.float32(0.1)))
    assert broken == ["idle time: not what is counted again"]


def test_numbers_of_events_have_the_odds_of_poisson():
    table = chance.poisson(1.3)
    draws = chance.draw_on_host(5, np.arange(40_000)) >> (32 - chance.CHANCE_BITS)
    counts = np.searchsorted(table, draws, side="right")
    assert counts.mean() == pytest.approx(1.3, abs=0.03)
    assert counts.var() == pytest.approx(1.3, abs=0.05)


def test_a_station_that_serves_longer_than_a_planner_knows_makes_no_run():
    rule = TASKS._replace(
        cycle=(STATION._replace(stay=lambda layout: np.full(layout.shape, 1001)),)
    )
    world = jax.jit(lambda layout: fleet.prepare(layout, rule, fleet.FleetConfig(2)))(FLOOR)
    assert not world.valid


@pytest.mark.slow
def test_learners_find_the_same_stays():
    environment = Environment(parse(["e.i"], TILES), TASKS, 1, 20)
    state, _ = environment.reset(jax.random.key(1))
    step, right, left = jax.jit(environment.step), 0, 1
    waits = []
    for _ in range(20):
        goal, here = int(state.goal[0, 0]), int(state.position[0])
        action = WAIT if goal == here else right if goal > here else left
        state, _ = step(state, jnp.array([action]))
        waits.append(int(state.remaining_service[0]))
    assert max(waits) == SHORT
