"""Where a fleet waits and works, and how many agents a layout takes: oracles and known jams."""

import threading
import weakref

import numpy as np
import pytest

import qdenv
from qdenv.domains.base import find_domain
from qdenv.grid import move_steps, parse
from qdenv.simulation.mapf.host import run as host
from qdenv.simulation.mapf.settings import FleetConfig, PibtConfig, find_planner
from qdenv.study import engine, traffic
from qdenv.study.engine import run_seeds
from qdenv.study.plans import Plan
from qdenv.study.recordings import (
    Maps,
    cells_with_half,
    count_moves,
    map_run,
    throughput_over_time,
    worst_cells,
)
from qdenv.study.traffic import Point, examine, judge, point_of
from qdenv.types import InputError, Traffic

pytestmark = pytest.mark.slow

WAREHOUSE, MAKING = find_domain("warehouse-even"), find_domain("manufacturing")
# Two halls and a lane with one bay in between: whoever meets in the lane is in the way.
LANE = parse(["w...@@@@@...e", "w.........e.e", "w...@@@@@...e"], WAREHOUSE.tiles)
TASKS = WAREHOUSE.simulator.tasks
HALLS = Plan("halls", LANE, WAREHOUSE, assumed=False)


def recorded(layout, tasks, agents, timesteps, planner=None):
    """Run two seeds; returns (traffic, recording) of each."""
    config = FleetConfig(agents + 3, timesteps, planner=planner or PibtConfig())
    kept = []
    run_seeds(layout, tasks, config, (4, 5), agents, lambda *run: kept.append(run[1:]), threads=1)
    return kept


@pytest.mark.parametrize("domain", [WAREHOUSE, MAKING], ids=["warehouse", "manufacturing"])
def test_maps_agree_with_a_walk_through_the_recording(domain):
    """Manufacturing robots are served for 2, 5 or 10 timesteps, which is no waiting."""
    layout, tasks = domain.resized(12, 14).human(), domain.simulator.tasks
    for run, tape in recorded(layout, tasks, 25, 70):
        maps = map_run(layout.shape, run, tape)
        cells = layout.size
        waiting, visits, finished, served = (np.zeros(cells) for _ in range(4))
        moves = np.zeros((5, cells))
        for agent in range(25):
            visits[tape.positions[0, agent]] += 1
            for step in range(run.end_timestep):
                before, after = tape.positions[step : step + 2, agent]
                visits[after] += before != after
                moves[list(move_steps(layout.shape[1])).index(after - before), before] += 1
                finished[after] += tape.finished[step, agent]
                if before == after:
                    at_work = after == tape.goals[step, agent]
                    assert at_work or tape.remaining_service[step, agent] == 0
                    served[after] += at_work
                    waiting[after] += not at_work
        end = int(run.end_timestep)
        np.testing.assert_allclose(maps.waiting.reshape(-1), waiting / end)
        np.testing.assert_allclose(maps.visits.reshape(-1), visits / end)
        np.testing.assert_allclose(maps.finished.reshape(-1), finished / 70)
        np.testing.assert_allclose(maps.moves.reshape(5, -1), moves / end)
        np.testing.assert_allclose(maps.usage, 25 * run.usage, atol=1e-5)
        assert maps.finished.sum() == pytest.approx(float(run.throughput))
        standing = maps.waiting_share + served.sum() / end / 25
        assert standing == pytest.approx(float(run.waiting), abs=1e-5)
        assert waiting.sum() > 0 and (served.sum() > 0) == (domain is MAKING)


def test_in_one_column_moves_are_down_and_up():
    moves = count_moves(np.array([[0], [1], [2], [2], [1]]), (3, 1))
    assert moves[:, :, 0].tolist() == [
        [0, 0, 0.25], [0, 0, 0], [0, 0, 0], [0.25, 0.25, 0], [0, 0, 0.25]
    ]  # fmt: skip


def test_maps_of_a_congested_run_end_with_it():
    config = FleetConfig(25, 100, planner=PibtConfig())
    kept = []
    run_seeds(LANE, TASKS, config, (0,), read=lambda *run: kept.append(run[1:]))
    (run, tape) = kept[0]
    assert run.congested and run.end_timestep < 100
    maps = map_run(LANE.shape, run, tape)
    assert maps.usage.sum() == pytest.approx(25)
    assert maps.finished.sum() == pytest.approx(float(run.throughput))


def test_the_worst_cells_come_first_with_their_share_and_wait_per_visit():
    waiting, visits = np.zeros((2, 3)), np.full((2, 3), 0.1)
    waiting[0, 2], waiting[1, 0], visits[1, 0] = 0.3, 0.6, 0.2
    maps = Maps(np.zeros((2, 3)), waiting, visits, np.zeros((2, 3)), 3.0, np.zeros((5, 2, 3)))
    layout = np.array([[0, 0, 1], [2, 0, 0]], np.int8)
    first, second = worst_cells(layout, maps)
    assert tuple(first.values()) == (1, 0, 2, pytest.approx(2 / 3), 0.6, pytest.approx(3.0))
    assert tuple(second.values()) == (0, 2, 1, pytest.approx(1 / 3), 0.3, pytest.approx(3.0))
    assert maps.waiting_share == pytest.approx(0.3)
    assert cells_with_half(maps) == 1
    assert len(worst_cells(layout, maps, 1)) == 1
    calm = maps._replace(waiting=np.zeros((2, 3)))
    assert worst_cells(layout, calm) == [] and cells_with_half(calm) == 0


def run_of(finished) -> Traffic:
    """A run that finishes so many tasks at each timestep."""
    finished = np.array(finished)
    return Traffic(finished.mean(), False, len(finished), finished, None, 0.0, 2.0)


def test_throughput_over_time_is_averaged_in_windows_over_the_runs():
    runs = [run_of([0, 2, 4, 6, 1]), run_of([2, 4, 6, 8, 3])]
    ends, mean, error = throughput_over_time(runs, 2)
    assert ends.tolist() == [2, 5]
    np.testing.assert_allclose(mean, [2, 14 / 3])
    np.testing.assert_allclose(error, [1, 1])
    assert np.isnan(throughput_over_time(runs[:1])[2]).all()


def point(agents, throughput, **changes) -> Point:
    return Point(agents, throughput, 0.01, 10, 0, 0.0)._replace(**changes)


def probing(throughputs):
    return lambda agents: point(agents, throughputs[agents])


@pytest.mark.parametrize(
    ("here", "others", "word", "reason", "probed"),
    [
        (point(200, 6.0, congested=5), {}, "congested", "5 of 10", []),
        (point(200, 6.0, congested=1), {}, "past its peak", "1 of 10", []),
        (point(200, 6.0, fading=0.06), {}, "past its peak", "falls by 6% with time", []),
        (point(200, 6.0), {150: 6.2}, "past its peak", "150 agents would move 3% more", [150]),
        (point(200, 6.0), {150: 5.8, 100: 6.2}, "past its peak", "100 agents", [150, 100]),
        (
            point(200, 6.0),
            {150: 5.8, 100: 5, 50: 3},
            "near capacity",
            "the last 50 agents add 3%",
            [150, 100, 50],
        ),
        (point(200, 6.0), {150: 5, 250: 5.4}, "near capacity", "move 10% less", [150, 250]),
        (point(200, 6.0), {150: 4.6, 250: 7.3}, "flows", "move 22% more", [150, 250]),
        (point(1, 0.1), {2: 0.2}, "flows", "2 agents would move 100% more", [2]),
        (point(2, 0.2), {1: 0.1, 3: 0.3}, "flows", "3 agents", [1, 3]),
        (point(300, 9.0), {225: 6.8}, "flows", "every free cell", [225]),
        (point(9, 0.0), {6: 0.0, 4: 0.0, 2: 0.5}, "past its peak", "2 agents", [6, 4, 2]),
    ],
)
def test_a_verdict_follows_from_the_runs_with_other_numbers(here, others, word, reason, probed):
    judged, because, points = judge(here, probing(others), 300)
    assert judged == word and reason in because
    assert [one.agents for one in points] == [here.agents, *probed]


def test_fading_is_told_from_chance():
    fades = run_of([1] * 25 + [8] * 25 + [7] * 25 + [5] * 25)
    assert point_of(9, [fades, fades]).fading == pytest.approx(3 / 8)
    once = run_of([0, 0, 1, 0, 0, 1, 0, 0, 0, 0, 0, 0])
    assert point_of(9, [once]).fading == 0.0
    assert point_of(9, [run_of([1, 0])]).fading == 0.0


@pytest.mark.parametrize(
    ("agents", "word"),
    [(4, "flows"), (8, "near capacity"), (12, "past its peak"), (20, "congested")],
)
def test_a_lane_between_two_halls_jams_with_its_agents(agents, word):
    config = FleetConfig(agents, 300, planner=PibtConfig())
    study = examine(HALLS, config, (0, 1, 2))
    assert study.verdict[0] == word and study.broken == []
    if agents == 12:  # beside the two mouths of the lane
        worst = {(spot["row"], spot["column"]) for spot in worst_cells(LANE, study.maps, 4)}
        assert worst == {(0, 3), (2, 3), (0, 9), (2, 9)}


def test_nine_hundred_robots_on_948_cells_are_past_the_peak():
    config = FleetConfig(900, 100, planner=find_planner("low"))
    study = examine(HALLS._replace(layout=WAREHOUSE.human()), config, (0,), False, False)
    assert not study.done.runs[0].congested  # the jam rule sees nothing
    assert study.verdict[0] == "past its peak"
    assert "675 agents would move" in study.verdict[1]


def test_a_verdict_changes_no_number_of_the_runs():
    """Its program has room for more agents."""
    config = FleetConfig(12, 80, planner=PibtConfig())
    plain = examine(HALLS, config, (0, 1), False, False, False)
    judged = examine(HALLS, config, (0, 1))
    for one, other in zip(plain.done.runs, judged.done.runs, strict=True):
        np.testing.assert_array_equal(one.finished, other.finished)
        np.testing.assert_array_equal(one.usage, other.usage)


def test_a_report_counts_what_the_runs_did():
    facts = qdenv.simulate(HALLS, 12, True, timesteps=90, seeds=2, planner="pibt")
    assert facts["valid"] is True and "verdict" not in facts
    assert 0.1 < facts["waiting_share"] < 0.9
    assert len(facts["worst_cells"]) == 10
    shares = [spot["share"] for spot in facts["worst_cells"]]
    assert shares == sorted(shares, reverse=True) and sum(shares) <= 1
    done = run_seeds(LANE, TASKS, FleetConfig(12, 90, planner=PibtConfig()), (0, 1))
    tasks = [int(run.finished.sum()) for run in done.runs]
    moves = [round(float(run.path_length) * n) for run, n in zip(done.runs, tasks, strict=True)]
    assert facts["steps_per_task"] == pytest.approx(sum(moves) / sum(tasks))
    assert facts["mean_of_all"] == pytest.approx(sum(tasks) / 180)


def test_compiling_is_not_counted_as_simulating(monkeypatch):
    """The first run of a process compiles for 17 s unless its machine code is cached."""
    order = []
    real = engine.fleet.compile_runs

    def compile_runs(*given):
        run = real(*given)

        def drive(world, seed, agents):
            order.append((seed, agents))
            return run(world, seed, agents)

        return drive

    monkeypatch.setattr(engine.fleet, "compile_runs", compile_runs)
    # A clock that only runs add to: the first of all, without agents, 17 s, each other one 1 s.
    seconds = {0: 17.0, 7: 1.0}
    clock = lambda: sum(seconds[agents] for _, agents in order)  # noqa: E731
    monkeypatch.setattr(engine.time, "process_time", clock)
    monkeypatch.setattr(engine.time, "thread_time", lambda: 0.0)
    config = FleetConfig(7, 31, planner=PibtConfig())
    first = run_seeds(LANE, TASKS, config, (3, 4), threads=1)
    assert order == [(0, 0), (3, 7), (4, 7)]  # no agents first
    assert (first.compile_seconds, first.cpu_seconds) == (17, 2)
    again = run_seeds(LANE, TASKS, config, (3,), threads=1)
    assert order[3:] == [(3, 7)] and (again.compile_seconds, again.cpu_seconds) == (0, 1)


def test_one_long_run_reports_its_progress(monkeypatch):
    """The run waits for the reports of its steps, so the load of the machine does not matter."""
    reports, seen = [], threading.Semaphore(0)

    def progress(*state):
        reports.append(state)
        seen.release()

    plan = host.run_to_the_end

    def run_to_the_end(planner, run):
        for share in (0.25, 0.5) if run.position.size else ():
            run.counters.time = share * 100
            while share not in {state[1] for state in reports}:
                assert seen.acquire(timeout=60)
        run.counters.time = 0
        plan(planner, run)

    monkeypatch.setattr(host, "run_to_the_end", run_to_the_end)
    monkeypatch.setattr(engine, "_POLL_SECONDS", 0.005)
    config = FleetConfig(6, 100, planner=PibtConfig())
    run_seeds(LANE, TASKS, config, (0,), progress=progress)
    assert reports[0] == ("compiling the simulator", -1, "")
    shares = [share for _, share, _ in reports[1:]]
    assert shares == sorted(shares) and shares[-1] == 1
    assert {0.25, 0.5} <= set(shares)


def test_a_recording_is_dropped_once_it_is_read():
    config, seen = FleetConfig(5, 20, planner=PibtConfig()), []

    def read(seed, run, tape):
        seen.append(weakref.ref(tape.positions))
        return seed, sum(one() is not None for one in seen)

    done = run_seeds(LANE, TASKS, config, (1, 2), read=read, threads=1)
    assert done.readings == [(1, 1), (2, 1)] and len(done.runs) == 2
    assert all(one() is None for one in seen)


def test_what_is_too_large_to_record_says_what_to_do(monkeypatch):
    monkeypatch.setattr(traffic, "_MOST_RECORDED", 1000)
    config = FleetConfig(10, 101, planner=PibtConfig())
    with pytest.raises(InputError, match="at most 100 timesteps; `simulate --no-audit` without"):
        examine(HALLS, config, (0,))
    with pytest.raises(InputError, match="at most 100 timesteps; `simulate --no-audit` without"):
        examine(HALLS, config, (0,), False, True, False)
    study = examine(HALLS, config, (0,), False, False, False)
    assert study.maps is None and study.row.mean_of_all > 0


@pytest.mark.parametrize(
    ("agents", "timesteps"), [(1, 2**31), (200, 20_000_000), (10**11, 10), (300, 9_999_999)]
)
def test_runs_that_cannot_be_counted_are_refused(agents, timesteps):
    with pytest.raises(InputError, match="at most"):
        FleetConfig(agents, timesteps)
