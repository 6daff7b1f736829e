"""Runs that are written down: nothing twice, nothing lost, nothing mistaken for something else."""

import numpy as np
import pytest

from experiments import ledger
from experiments.agreement import agree, correlate
from experiments.ledger import Case, Run, complete, outcomes_of, read_runs, seconds_for
from qdenv.domains.base import find_domain
from qdenv.io.files import write_csv
from qdenv.simulation.mapf.settings import FleetConfig
from qdenv.study import engine
from qdenv.types import InputError, Traffic

WAREHOUSE = find_domain("warehouse-even")
HALL = WAREHOUSE.resized(9, 12).human()
CASE = Case("hall", HALL, WAREHOUSE, 4, 20, "low")


def run_alone(agents: int) -> Traffic:
    """Simulate seed 3 by a program for this number of agents."""
    config = FleetConfig(agents, 20, planner=ledger.DRIVERS["low"])
    return engine.run_seeds(HALL, WAREHOUSE.simulator.tasks, config, [3]).runs[0]


@pytest.fixture
def simulated(monkeypatch) -> list[tuple[str, int]]:
    """Simulate nothing; remember which cases and seeds were asked for."""
    asked: list[tuple[str, int]] = []

    def simulate(case: Case, seed: int) -> Run:
        asked.append((case.planner, seed))
        return Run(*case.key(seed), 1.5 + seed, False, case.timesteps, 2.0)

    monkeypatch.setattr(ledger, "simulate", simulate)
    return asked


def test_a_run_is_as_the_study_of_one_layout_has_it(tmp_path):
    found = complete(tmp_path / "runs.csv", [CASE], (3,))
    run = run_alone(4)
    assert found == read_runs(tmp_path / "runs.csv")
    assert found[0].throughput == pytest.approx(float(run.throughput), rel=1e-5)
    assert found[0].end_timestep == 20 and 0 <= found[0].cpu_seconds < 60


def test_numbers_of_agents_share_a_program_and_move_what_they_move_alone():
    ledger.simulate(CASE, 0)
    compiled = engine._program.cache_info().misses
    found = ledger.simulate(CASE._replace(agents=7), 3)
    assert engine._program.cache_info().misses == compiled
    alone = run_alone(7)
    assert found.throughput == pytest.approx(float(alone.throughput), rel=1e-5)


def test_only_missing_runs_are_simulated_and_all_come_back_in_order(simulated, tmp_path):
    path, cases = tmp_path / "runs.csv", [CASE, CASE._replace(planner="plain")]
    complete(path, [cases[1]], (1,))
    found = complete(path, cases, (0, 1, 2))
    every = [(planner, seed) for planner in ("low", "plain") for seed in range(3)]
    assert simulated == [("plain", 1), *(one for one in every if one != ("plain", 1))]
    assert [(run.planner, run.seed) for run in found] == every
    assert complete(path, cases, (0, 1, 2)) == found and len(simulated) == 6


def test_a_run_that_another_file_holds_is_not_simulated(simulated, tmp_path):
    complete(tmp_path / "other.csv", [CASE], (0, 1))
    complete(tmp_path / "runs.csv", [CASE], (0, 1, 2), [tmp_path / "other.csv"])
    assert simulated == [("low", 0), ("low", 1), ("low", 2)]
    assert [run.seed for run in read_runs(tmp_path / "runs.csv")] == [2]


@pytest.mark.parametrize(
    "other", [{"agents": 5}, {"timesteps": 30}, {"stop": False}, {"tiles": np.roll(HALL, 1, 0)}]
)
def test_a_case_that_differs_in_one_number_has_runs_of_its_own(other, simulated, tmp_path):
    for case in (CASE, CASE._replace(**other)):
        complete(tmp_path / "runs.csv", [case], (0,))
    assert len(simulated) == 2


def test_an_interrupted_study_keeps_what_was_done(simulated, tmp_path, monkeypatch):
    counted = ledger.simulate

    def stop_at_two(case: Case, seed: int) -> Run:
        if seed == 2:
            raise KeyboardInterrupt
        return counted(case, seed)

    monkeypatch.setattr(ledger, "simulate", stop_at_two)
    with pytest.raises(KeyboardInterrupt):
        complete(tmp_path / "runs.csv", [CASE], range(5))
    assert [run.seed for run in read_runs(tmp_path / "runs.csv")] == [0, 1]


def test_what_is_left_is_reckoned_from_runs_of_the_same_planner(simulated, tmp_path, capsys):
    slow = Run(*CASE.key(0), 1.0, False, 20, 8.0)  # 0.1 s for each of 4 agents and 20 timesteps
    fast = slow._replace(planner="plain", cpu_seconds=0.8)
    cases = [CASE._replace(agents=8), CASE._replace(planner="plain")]
    assert seconds_for(cases, [slow, fast]) == pytest.approx(16 + 0.8)
    assert seconds_for(cases[1:], [slow]) == pytest.approx(8)
    complete(tmp_path / "runs.csv", [CASE], (0, 1))
    said = "2 of 2 runs, about 0:00:00 of one core left: hall, 4 agents, low, seed 1: 2.500\n"
    assert capsys.readouterr().out == said


def test_mistakes_are_refused_before_anything_is_simulated(simulated, tmp_path):
    path = tmp_path / "runs.csv"
    for case, said in (
        (CASE._replace(planner="lwo"), "unknown planner 'lwo'"),
        (CASE._replace(agents=900), "hall: .*free cells"),
    ):
        with pytest.raises(InputError, match=said):
            complete(path, [CASE, case], (0,))
    path.write_text("a,b\n1,2\n")
    with pytest.raises(InputError, match="cannot be read"):
        complete(path, [CASE], (0,))
    good = Run(*CASE.key(0), 1.0, False, 20, 8.0)
    write_csv(path, Run._fields, [good, [*good[:9], "Maybe", *good[10:]]])
    with pytest.raises(InputError, match="Maybe"):
        read_runs(path)
    assert not simulated


def test_outcomes_average_successful_runs_and_say_when_the_others_congested():
    good = [Run(*CASE.key(seed), 2.0 + seed, False, 20, 1.0) for seed in range(2)]
    bad = [Run(*CASE.key(seed), 0.5, True, seed, 3.0) for seed in (5, 6, 10)]
    (one,) = outcomes_of([*good, *bad, good[0]])  # one is given twice
    assert (one.runs, one.successes, one.throughput) == (5, 2, 2.5)
    assert one.error == pytest.approx(0.5)  # of 2 and 3: 0.707 / sqrt 2
    assert (one.jam_median, one.jam_least, one.jam_most) == (6, 5, 10)
    assert one.mean_of_all == pytest.approx(6.5 / 5) and one.cpu_seconds == pytest.approx(11 / 5)
    (none,) = outcomes_of(run._replace(stop=False) for run in bad)
    assert none.successes == 0 and np.isnan([none.throughput, none.jam_median]).all()


@pytest.mark.slow
def test_agreement_of_a_hand_made_table():
    paper = np.array([1.0, 2, 4, 8, 16])
    found = agree(paper[[1, 0, 2, 4, 3]], paper)
    assert found.spearman.value == pytest.approx(0.8)  # 1 - 6 * 4 / (5 * 24)
    assert found.kendall.value == pytest.approx(0.6)  # two of ten pairs are swapped
    assert found.ratio.mean == pytest.approx((2 + 0.5 + 1 + 2 + 0.5) / 5)
    assert found.layouts == 5
    assert np.isnan(correlate("kendall", paper[:2], paper[:2]).value)


@pytest.mark.slow
def test_the_interval_of_a_correlation_holds_the_truth_about_95_times_in_100(monkeypatch):
    monkeypatch.setattr("experiments.agreement.RESAMPLES", 300)
    rng, truth, inside = np.random.default_rng(1), 0.8, 0
    # Spearman's correlation of normal pairs whose Pearson correlation is r: 6 asin(r / 2) / pi.
    r = 2 * np.sin(np.pi * truth / 6)
    for seed in range(20):
        pairs = rng.multivariate_normal([0, 0], [[1, r], [r, 1]], 40)
        found = correlate("spearman", *pairs.T, seed=seed)
        assert found.low < found.value < found.high
        inside += found.low < truth < found.high
    assert inside >= 17
