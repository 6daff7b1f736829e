"""Guidance from planned tasks: a slow oracle agrees, closed forms, published throughputs."""

import heapq

import numpy as np
import pytest
from conftest import STUDY_DATA

from qdenv import highways
from qdenv.domains.base import find_domain
from qdenv.grid import DOWN, LEFT, RIGHT, UP, move_steps, parse
from qdenv.guidance import GUIDANCE, existing_moves, fixed_costs
from qdenv.highways import _price, human_cost, traffic_flow
from qdenv.simulation.mapf.goals import task_odds
from qdenv.simulation.mapf.settings import FleetConfig, PibtConfig
from qdenv.study.engine import run_seeds
from qdenv.study.plans import Plan, guide, read_plan
from qdenv.types import InputError

WAREHOUSE = find_domain("warehouse-even")
TASKS = WAREHOUSE.simulator.tasks
ROWS = ["w.....e.w", ".@e@.@.@.", "e...e...e", ".@.@e@.@.", "w...e...w"]
LAYOUT = parse(ROWS, WAREHOUSE.tiles)
BACK = {RIGHT: LEFT, LEFT: RIGHT, DOWN: UP, UP: DOWN}


def oracle(free: np.ndarray, ends: np.ndarray, contraflow: bool) -> np.ndarray:
    """Plan tasks with costs that are computed from scratch before each of them."""
    steps, tasks, cells = move_steps(free.shape[1]), ends.shape[1], free.size
    moves = existing_moves(free).reshape(5, -1)
    uses, visits = np.zeros((5, cells)), np.zeros(cells)
    prices = np.where(moves, 1.0 if contraflow else 2.0, np.inf)
    for begin, end in ends.T:
        distance, way, queue = np.full(cells, np.inf), {}, [(0.0, begin)]
        distance[begin] = 0
        while queue:
            cost, cell = heapq.heappop(queue)
            for move in BACK if cost == distance[cell] else ():
                other = cell + steps[move]
                if moves[move, cell] and cost + prices[move, cell] < distance[other]:
                    distance[other], way[other] = cost + prices[move, cell], move
                    heapq.heappush(queue, (distance[other], other))
        cell = end
        visits[cell] += 1
        while cell != begin:
            move = way[cell]
            cell -= steps[move]
            uses[move, cell] += 1
            visits[cell] += 1
        for move, back in BACK.items():
            here = np.flatnonzero(moves[move])
            there = here + steps[move]
            one, two = uses[move, here], uses[back, there]
            if contraflow:
                prices[move, here] = 1 + one * two + np.ceil((visits[there] - 1) / 2)
            else:
                load = (one + two) / (2 * tasks)
                prices[move, here] = 1 - 0.5 * one / tasks + 1.2 * two / tasks + 1.3**load
    prices[0] = np.inf
    return prices


@pytest.mark.parametrize("contraflow", [False, True])
def test_a_slow_oracle_plans_the_same_ways(contraflow):
    free = np.pad(LAYOUT != 1, 1)
    rng = np.random.default_rng(3)
    ends = rng.choice(np.flatnonzero(free), (2, 80))
    ends[1] = np.where(ends[1] == ends[0], ends[1, ::-1], ends[1])
    found = _price(free.reshape(-1), move_steps(free.shape[1]), ends, contraflow)
    expected = oracle(free, ends, contraflow)
    exist = existing_moves(free).reshape(5, -1)
    exist[0] = False
    np.testing.assert_array_equal(np.isfinite(found), exist)
    np.testing.assert_allclose(found[exist], expected[exist], rtol=1e-12)


def test_in_a_lane_all_moves_cost_the_same():
    """All tasks drive from end to end of it, half of them each way, so all costs are known."""
    layout = parse(["e....w"], WAREHOUSE.tiles)
    free, odds = layout != 1, task_odds(layout, TASKS)
    assert odds.shape == (1, 2, 1, 6)
    costs = traffic_flow(free, odds)
    assert len(set(costs[existing_moves(free)][6:])) == 1
    lane = human_cost(free, odds)
    assert (lane == 1).all()  # a fifth of a seventh of ten moves is none


def test_highways_are_a_fifth_of_a_seventh_of_all_moves():
    free = LAYOUT != 1
    costs, moves = human_cost(free, task_odds(LAYOUT, TASKS)), existing_moves(free)
    moves[0] = False
    halved = costs == 0.5
    assert halved.sum() == int(int(moves.sum() / 7) / 5) == (costs != 1).sum()
    assert moves[halved].all()


def test_flow_is_scaled_to_the_published_range_and_the_same_each_time():
    free, odds = LAYOUT != 1, task_odds(LAYOUT, TASKS)
    costs, moves = traffic_flow(free, odds), existing_moves(free)
    moves[0] = False
    assert costs[moves].min() == 0.1 and costs[moves].max() == pytest.approx(100)
    assert (costs[0] == 1).all()
    np.testing.assert_array_equal(costs, GUIDANCE["traffic-flow"](free, odds))


def test_the_dearest_moves_stay_apart_in_whole_numbers():
    free = np.ones((8, 8), bool)
    costs = np.ones((5, 8, 8))
    costs[RIGHT, 0, :2] = 30, 28
    fixed = fixed_costs(costs, free)
    assert fixed[RIGHT, 0, 0] == 1023 > fixed[RIGHT, 0, 1] > 900


def test_a_floor_of_one_cell_has_no_moves_to_charge():
    free, legs = np.ones((1, 1), bool), np.ones((1, 2, 1, 1))
    for guidance in (traffic_flow, human_cost):
        assert (guidance(free, legs) == 1).all()


def test_a_floor_without_goals_is_refused():
    plan = Plan("empty", np.zeros((3, 3), np.int8), WAREHOUSE, assumed=False)
    with pytest.raises(InputError, match="empty: robots have nothing to do: the layout has no"):
        guide(plan, "human-cost")


@pytest.mark.slow
@pytest.mark.parametrize(("name", "published"), [("human-cost", 5.63), ("traffic-flow", 5.84)])
def test_published_throughputs(name, published, monkeypatch):
    """Setup 2 in table 3 of Zhang et al. 2024, where tasks and highways are one draw of many."""
    path = STUDY_DATA / "guidance" / "pibt_warehouse_33x36_w_mode.json"
    if not path.exists():
        pytest.skip("no published floors here (QDENV_STUDY_DATA names their folder)")
    monkeypatch.setattr(highways, "_TASKS", 20_000)
    config = FleetConfig(400, 1000, 1, 1, PibtConfig(), stop_when_congested=False)
    moved = []
    for seed in range(5):
        monkeypatch.setattr(highways, "_SEED", seed)
        runs = run_seeds(guide(read_plan(path), name).floor, TASKS, config, range(3)).runs
        moved.append(np.mean([float(run.throughput) for run in runs]))
    spread = np.std(moved, ddof=1)
    print(name, np.round(moved, 2))
    assert abs(np.mean(moved) - published) < max(2 * spread, 0.04 * published)
