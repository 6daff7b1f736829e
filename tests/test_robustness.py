"""The campaign repeats every attempt and reports every broken promise; its checkers find faults."""

import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from robustness import campaign, fleets, repairs
from robustness.campaign import Attack, Attempt

import qdenv
from qdenv.repairs.recipe import repair_layout
from qdenv.repairs.rules import Facts
from qdenv.repairs.settings import RepairConfig
from qdenv.types import Floor, RepairStatus

pytestmark = pytest.mark.slow


def throw_die(rng: np.random.Generator, folder: Path) -> Attempt:
    """Break a promise if the die shows six, and leave a file in the folder."""
    assert not list(folder.iterdir())
    folder.joinpath("left").touch()
    die = int(rng.integers(1, 7))
    return Attempt(die, ["the die shows six"] * (die == 6), {"throws": 1})


def tire(rng: np.random.Generator, folder: Path) -> Attempt:
    if rng.random() < 0.2:
        raise KeyboardInterrupt
    return Attempt(1)


DICE = Attack("dice", "no six", "pips", throw_die)
CALM = Attack("calm", "nothing happens", "breaths", lambda rng, folder: Attempt(1))
TIRED = CALM._replace(name="tired", attempt=tire)


@pytest.fixture(autouse=True)
def attacks(monkeypatch):
    monkeypatch.setattr(campaign, "all_attacks", lambda: [DICE, CALM, TIRED])


def attack(attack: Attack, seed: int, numbers: range) -> dict:
    row = campaign.new_row(attack)
    for number in numbers:
        campaign.attack_once(attack, row, seed, number)
    return row


def test_the_table_and_the_file_count_the_attempts(tmp_path, capsys):
    counts = tmp_path / "counts.json"
    result = campaign.run(minutes=0, seed=3, only=("calm",), json=counts)
    printed = capsys.readouterr().out.splitlines()
    assert printed[0] == "seed 3: calm"
    assert printed[1].split()[:5] == ["calm", "1", "breaths", "no", "faults"]
    assert json.loads(counts.read_text()) == result
    (row,) = result["attacks"]
    assert (row["attempts"], row["breaths"], row["faults"]) == (1, 1, [])


def test_an_interrupted_campaign_reports_its_counts(tmp_path, capsys, monkeypatch):
    saves = []  # what an interrupted process does before its end
    monkeypatch.setattr(campaign.interrupt, "save_first", saves.append)
    with pytest.raises(KeyboardInterrupt):
        campaign.run(seed=1, only=("tired",), json=tmp_path / "counts.json")
    saves[0]()
    (row,) = json.loads((tmp_path / "counts.json").read_text())["attacks"]
    assert row["attempts"] == row["breaths"] > 0
    assert f"{row['breaths']} breaths" in capsys.readouterr().out


def test_a_broken_promise_ends_with_code_1_and_the_line_that_repeats_it(capsys):
    number = attack(DICE, 11, range(100))["faults"][0]["attempt"]
    capsys.readouterr()
    with pytest.raises(SystemExit) as ended:
        campaign.run(minutes=0, seed=11, only=("dice",), first=number)
    assert ended.value.code == 1
    fault, again, row = capsys.readouterr().out.splitlines()[1:]
    assert fault == "FAULT the die shows six"
    assert again.endswith(f"robustness --only dice --seed 11 --first {number} --minutes 0")
    assert "1 faults" in row and "1 throws" in row


def test_an_unknown_attack_is_refused():
    with pytest.raises(qdenv.InputError, match="no attack 'knives': choose from dice, calm"):
        campaign.run(only=("knives",))
    with pytest.raises(qdenv.InputError, match="calm has no kind 'x': none"):
        campaign.run(only=("calm:x",))


def test_an_attack_is_held_to_one_kind(monkeypatch, capsys):
    def draw(rng, folder, kind="any"):
        return Attempt(1, [kind])

    monkeypatch.setattr(
        campaign, "all_attacks", lambda: [DICE._replace(attempt=draw, kinds=("a b",))]
    )
    with pytest.raises(SystemExit):
        campaign.run(minutes=0, seed=1, only=("dice:a b",))
    fault, again, _ = capsys.readouterr().out.splitlines()[1:]
    assert fault == "FAULT a b" and "--only 'dice:a b' --seed 1 " in again


def test_the_same_seed_makes_the_same_attempt_again():
    first, second = (attack(repairs.REPAIRS, 2, range(2)) for _ in range(2))
    assert first | {"seconds": 0} == second | {"seconds": 0}
    tasks = [repairs.draw_task(np.random.default_rng([2, number])) for number in range(40)]
    assert len({task.layout.tobytes() for task in tasks}) == 40
    assert {task.name.split()[0] for task in tasks} == set(repairs.DOMAINS)


def test_faults_of_a_repair_are_found():
    task = repairs.draw_task(np.random.default_rng(1))
    *infeasible, cost, bound = repairs.faults_of(task, task.layout, cost=3.0, bound=4.0)
    assert infeasible and cost.startswith("cost 3.0") and bound.startswith("lower bound")
    status = RepairStatus
    for contradiction in (
        (status.FAILED, np.inf, "none", np.inf),
        (status.IMPOSSIBLE, np.inf, "found", 3.0),
        (status.OPTIMAL, 4.0, "found", 3.0),
        (status.ANNEALED, 4.0, "none", np.inf),
        (status.ANNEALED, 2.0, "found", 3.0),
    ):
        assert repairs.contradictions(*contradiction)
    assert not repairs.contradictions(status.ANNEALED, 4.0, "found", 3.0)
    assert not repairs.contradictions(status.IMPOSSIBLE, np.inf, "none", np.inf)
    assert not repairs.contradictions(status.FAILED, np.inf, "unknown", 0.0)


@pytest.mark.parametrize(("shelves", "exists"), [(5, True), (9, False)])
def test_the_exact_program_finds_the_cheapest_layout_or_none(shelves, exists):
    rules = qdenv.find_domain("warehouse-even").resized(6, 6, {"shelves": shelves}).rules()
    layout = np.random.default_rng(5).integers(0, 4, (6, 6)).astype(np.int8)
    verdict, cost = repairs.solve_exactly(layout, Facts(rules))
    best = repair_layout(layout, rules, 0, RepairConfig("full"))
    assert verdict == ("found" if exists else "none")
    assert best.status == (RepairStatus.OPTIMAL if exists else RepairStatus.IMPOSSIBLE)
    assert cost == best.cost


def test_a_fixed_shelf_that_nothing_serves_is_no_layout_to_the_exact_program():
    rules = qdenv.find_domain("warehouse-even").resized(3, 9, {"shelves": 1}).rules()
    allowed = rules.allowed.copy()
    for cell, tile in {(2, 2): "@", (1, 2): ".", (2, 3): "."}.items():
        allowed[cell] = np.arange(4) == rules.tiles.index(tile)
    rules, layout = rules._replace(allowed=allowed), np.zeros((3, 9), np.int8)
    assert repairs.solve_exactly(layout, Facts(rules))[0] == "none"
    assert repair_layout(layout, rules).status == RepairStatus.IMPOSSIBLE


def test_fleets_are_audited_in_both_backends_and_a_wrong_step_is_found(monkeypatch):
    monkeypatch.setattr(fleets, "PLANNERS", {"pibt": fleets.PLANNERS["pibt"]})
    monkeypatch.setattr(fleets, "XLA_SHARE", 1.0)
    monkeypatch.setattr(fleets, "RULES", ("services",))
    row = attack(fleets.AUDITS, 4, range(1))
    assert row["faults"] == []
    runs = 2 * fleets.RUNS
    both = {"runs": runs, "runs in both backends": fleets.RUNS, "pibt": fleets.RUNS}
    assert row["notes"] >= Counter(both)
    assert row["agent-steps"] >= fleets.TIMESTEPS * runs
    monkeypatch.setattr(fleets, "audit", lambda *_: ["t=1: two agents on cell 3"])
    faults = fleets.attempt(np.random.default_rng([4, 0, *b"audits"]), Path()).faults
    assert len(faults) == runs and "two agents" in faults[0]


def test_moves_against_a_one_way_lane_and_goals_without_their_odds_are_found():
    layout, tasks = np.array([[0, 2, 3]], np.int8), fleets.tasks_of("plain")
    costs = np.ones((5, 1, 3), np.int32)
    costs[2, 0, 1] = 0  # to the left from the middle
    there, back = np.array([[0], [1], [2]]), np.array([[2], [1], [0]])
    assert fleets.forbidden(Floor(layout, costs), there) == []
    assert "t=2: agent 0" in fleets.forbidden(Floor(layout, costs), back)[0]
    wide, rng = np.array([[2, 2, 2, 3]], np.int8), np.random.default_rng(0)
    for odds, total in (([1, 1, 1], 12.0), ([2, 1, 1], 150.0)):
        cells = rng.choice(3, 1800, p=np.divide(odds, sum(odds)))
        chi_square, freedom = fleets.compare_odds(wide, tasks, [cells, np.full(9, 3)])
        assert freedom == 2 and (chi_square > total) == (total > 12)
