"""The campaign: every attempt can be repeated, every broken promise is told and counted."""

import json
from pathlib import Path

import numpy as np
import pytest
from robustness import audits, campaign, repairs
from robustness.attack import Attack, Attempt

from qdenv.domains.base import find_domain
from qdenv.repair.recipe import repair_layout
from qdenv.repair.rules import Facts
from qdenv.repair.settings import RepairConfig
from qdenv.types import InputError, RepairStatus


def planted(chance: np.random.Generator, folder: Path) -> Attempt:
    """Break a promise where the die shows six, and leave something in the folder."""
    assert not list(folder.iterdir())
    folder.joinpath("left").touch()
    die = int(chance.integers(1, 7))
    return Attempt(die, ("the die shows six",) if die == 6 else (), {"throws": 1})


PLANTED = Attack("dice", "no six", "pips", planted)
HARMLESS = Attack("calm", "nothing happens", "breaths", lambda chance, folder: Attempt(1))


@pytest.fixture
def attacks(monkeypatch):
    monkeypatch.setattr(campaign, "ATTACKS", (PLANTED, HARMLESS))


def first_six(seed: int) -> int:
    """Number the first attempt of the dice that breaks the promise."""
    tally = campaign.Tally(PLANTED)
    while not tally.faults:
        campaign.attack_once(tally, seed, tally.attempts)
    return tally.faults[0][0]


def test_the_table_counts_what_was_tried_and_its_file_says_the_same(attacks, tmp_path, capsys):
    counts = tmp_path / "counts.json"
    result = campaign.run(minutes=0, seed=3, only=("calm",), json_file=counts)
    printed = capsys.readouterr().out.splitlines()
    assert printed[0] == "seed 3: calm"
    assert printed[1].split()[:5] == ["calm", "1", "breaths", "no", "fault"]
    assert json.loads(counts.read_text()) == result
    (row,) = result["attacks"]
    assert (row["attempts"], row["breaths"], row["faults"]) == (1, 1, [])


def test_an_interrupted_campaign_tells_what_it_has_counted(monkeypatch, tmp_path, capsys):
    def tire(chance: np.random.Generator, folder: Path) -> Attempt:
        if chance.random() < 0.2:
            raise KeyboardInterrupt
        return Attempt(1)

    monkeypatch.setattr(campaign, "ATTACKS", (HARMLESS._replace(attempt=tire),))
    counts = tmp_path / "counts.json"
    with pytest.raises(KeyboardInterrupt):
        campaign.run(seed=1, json_file=counts)
    (row,) = json.loads(counts.read_text())["attacks"]
    assert row["attempts"] == row["breaths"] > 0
    assert f"{row['breaths']} breaths" in capsys.readouterr().out


def test_a_broken_promise_ends_with_code_1_and_the_line_that_repeats_it(attacks, capsys):
    number = first_six(11)
    capsys.readouterr()
    with pytest.raises(SystemExit) as ended:
        campaign.run(minutes=0, seed=11, only=("dice",), first=number)
    assert ended.value.code == 1
    fault, again, row = capsys.readouterr().out.splitlines()[1:]
    assert fault == "FAULT the die shows six"
    assert again.endswith(f"robustness --only dice --seed 11 --first {number} --minutes 0")
    assert "1 faults" in row and "1 throws" in row


def test_an_unknown_attack_is_refused_and_all_are_chosen_by_default(attacks):
    with pytest.raises(InputError, match="no attack 'knives': choose from dice, calm"):
        campaign.run(only=("knives",))
    assert campaign.choose(()) == [PLANTED, HARMLESS]


def test_the_same_seed_makes_the_same_attempt_again():
    def outcome(number: int) -> tuple:
        tally = campaign.Tally(repairs.REPAIRS)
        campaign.attack_once(tally, 2, number)
        return tally.count, tally.faults, dict(tally.notes)

    assert [outcome(number) for number in range(4)] == [outcome(number) for number in range(4)]
    tasks = [repairs.draw_task(np.random.default_rng([2, number])) for number in range(40)]
    assert len({task.layout.tobytes() for task in tasks}) == 40
    assert {task.name.split()[0] for task in tasks} == set(repairs.KINDS)


def test_what_is_wrong_with_a_repair_is_named():
    task = repairs.draw_task(np.random.default_rng(1))
    broken = repairs.examine(task, task.layout, cost=3.0, bound=4.0)
    assert [fault.split()[0] for fault in broken[-2:]] == ["a", "the"]
    assert any("infeasible" in fault for fault in broken)
    says = repairs.contradictions
    assert says(RepairStatus.FAILED, np.inf, "none", np.inf)
    assert says(RepairStatus.IMPOSSIBLE, np.inf, "found", 3.0)
    assert says(RepairStatus.OPTIMAL, 4.0, "found", 3.0)
    assert says(RepairStatus.ANNEALED, 4.0, "none", np.inf)
    assert says(RepairStatus.ANNEALED, 2.0, "found", 3.0)
    assert not says(RepairStatus.ANNEALED, 4.0, "found", 3.0)
    assert not says(RepairStatus.IMPOSSIBLE, np.inf, "none", np.inf)
    assert not says(RepairStatus.FAILED, np.inf, "unknown", 0.0)


def test_the_exact_program_finds_the_cheapest_layout_and_refutes():
    domain, rng = find_domain("warehouse-even"), np.random.default_rng(5)
    layout = np.asarray(repairs._draw_layout(rng, domain.resized(6, 6).rules()))
    for shelves, exists in ((5, True), (7, True), (9, False)):
        rules = domain.resized(6, 6, {"shelves": shelves}).rules()
        verdict, cost = repairs.solve_exactly(layout, Facts(rules))
        best = repair_layout(layout, rules, 0, RepairConfig("full"))
        assert verdict == ("found" if exists else "none")
        assert best.status == (RepairStatus.OPTIMAL if exists else RepairStatus.IMPOSSIBLE)
        assert cost == best.cost


def test_a_fixed_shelf_that_nothing_serves_is_no_layout_to_the_exact_program():
    rules = find_domain("warehouse-even").resized(3, 9, {"shelves": 1}).rules()
    allowed = rules.allowed.copy()
    for cell, tile in {(2, 2): "@", (1, 2): ".", (2, 3): "."}.items():
        allowed[cell] = np.arange(4) == rules.tiles.index(tile)
    rules, layout = rules._replace(allowed=allowed), np.zeros((3, 9), np.int8)
    assert repairs.solve_exactly(layout, Facts(rules))[0] == "none"
    assert repair_layout(layout, rules).status == RepairStatus.IMPOSSIBLE


def test_fleets_are_audited_in_both_backends_and_a_wrong_step_is_found(monkeypatch):
    monkeypatch.setattr(audits, "DRIVERS", {"pibt": audits.DRIVERS["pibt"]})
    monkeypatch.setattr(audits, "TWIN_SHARE", 1.0)
    monkeypatch.setattr(audits, "NAMES", ("services",))
    tally = campaign.Tally(audits.AUDITS)
    for number in range(2):
        campaign.attack_once(tally, 4, number)
    assert tally.faults == [] and tally.notes["runs in both backends"] == 2 * audits.RUNS
    assert tally.count > audits.TIMESTEPS * tally.notes["runs"]
    monkeypatch.setattr(audits, "audit", lambda *_: ["t=1: two agents on cell 3"])
    found = audits.attempt(np.random.default_rng([4, 0, *b"audits"]), Path())
    assert len(found.faults) >= audits.RUNS and "two agents" in found.faults[0]
