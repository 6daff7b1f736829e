"""One run to be looked at: its waiting and its jams are those that the studies count."""

import numpy as np
import pytest
from small_warehouse import ROWS, TILES

from qdenv.domains.base import find_domain
from qdenv.grid import parse
from qdenv.simulation.mapf.settings import FleetConfig
from qdenv.study.engine import run_seeds
from qdenv.study.plans import Plan
from qdenv.study.recordings import MOST_SHOWN, map_run, record_fleet, trace_agent
from qdenv.types import InputError

pytestmark = pytest.mark.slow

CORRIDOR = ["@@@@@@@@", "w.....ee", "@@@@@@@@"]
MAZE = ["XXXXXX", "X    X", "XXXX X", "X    X", "XXXXXX"]


@pytest.fixture(scope="module")
def warehouse():
    return Plan("small", parse(ROWS, TILES), find_domain("warehouse-even"), assumed=False)


@pytest.mark.parametrize("agents", [6, 55])
def test_waiting_and_tasks_are_those_of_the_studies(warehouse, agents):
    config = FleetConfig(agents, 40, stop_when_congested=False)
    motion, _ = record_fleet(warehouse, config, 3)
    layout, tasks = warehouse.layout, warehouse.domain.simulator.tasks
    done = run_seeds(layout, tasks, config, [3], read=lambda *run: map_run(layout.shape, *run[1:]))
    assert motion.waits.mean() == pytest.approx(done.readings[0].waiting_share)
    np.testing.assert_array_equal(motion.finished.sum(1), done.runs[0].finished)
    assert motion.steps == motion.timesteps == 40
    assert (agents == 55) == (motion.waits.mean() > 0.2)


def test_congested_stretches_begin_where_the_simulator_says_and_last_while_robots_stand(warehouse):
    corridor = warehouse._replace(layout=parse(CORRIDOR, TILES))  # nobody passes anybody
    going_on = FleetConfig(6, 40, stop_when_congested=False)
    motion, traffic = record_fleet(corridor, going_on, 0)
    assert traffic.congested and motion.congested
    begin, _ = motion.congested[0]
    assert begin + going_on.horizon == traffic.congested_at
    for begin, end in motion.congested:
        for window in range(begin, end, going_on.horizon):
            cells = motion.positions[window : window + going_on.horizon]
            assert (cells == cells[0]).all(0).sum() > 3
    ended, traffic = record_fleet(corridor, FleetConfig(6, 40), 0)
    assert ended.steps == traffic.end_timestep == traffic.congested_at < 40
    np.testing.assert_array_equal(ended.positions, motion.positions[: ended.steps + 1])


def test_the_agent_of_a_maze_walks_from_start_to_beside_its_goal():
    plan = Plan("maze", parse(MAZE, " X"), find_domain("maze-walls"), assumed=False)
    motion = trace_agent(plan, seed=1)
    cells = motion.positions[:, 0]
    row, column = cells // 6, cells % 6
    assert (plan.layout[row, column] == 0).all()
    assert (np.abs(np.diff(row)) + np.abs(np.diff(column)) <= 1).all()
    assert motion.shortest == 8 and motion.timesteps == 2 * 5 * 6
    assert len(motion.headings) == motion.steps + 1
    assert motion.finished.sum() == motion.finished[-1].sum() == 1
    assert np.abs(cells[-1] - motion.goals[0, 0]) in (1, 6)


def test_what_no_browser_could_play_is_refused(warehouse):
    with pytest.raises(InputError, match=f"at most {MOST_SHOWN // 50} timesteps"):
        record_fleet(warehouse, FleetConfig(50, MOST_SHOWN // 50 + 1))
    with pytest.raises(InputError, match="seed must be at least 0, not -1"):
        record_fleet(warehouse, FleetConfig(5, 10), -1)
