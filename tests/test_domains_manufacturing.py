"""Manufacturing: rules, price, measures and tasks against drawings and plain-numpy oracles."""

import json
import math
from collections import Counter

import jax.numpy as jnp
import numpy as np
import pytest

from qdenv import grid
from qdenv.configurations import find_preset
from qdenv.domains.base import find_domain, make_domain
from qdenv.domains.manufacturing import TILES, ManufacturingConfig, rules
from qdenv.repairs.anneal.loop import anneal
from qdenv.repairs.audit import audit
from qdenv.repairs.rules import Facts
from qdenv.score import similarity
from qdenv.simulation.mapf import planner

DOMAIN = find_domain("manufacturing")
GOOD = ["..e..", ".e0e.", "..e..", "e1.2e", ".e.e."]


def broken(drawing: list[str]) -> list[str]:
    layout = grid.parse(drawing, TILES)
    return [violation.message for violation in audit(layout, rules(*layout.shape))]


def test_rules_accept_a_proper_factory():
    assert broken(GOOD) == []


@pytest.mark.parametrize(
    ("drawing", "said"),
    [
        (["..e..", ".e0e.", "..e..", "e1..e", ".e.e."], "0 '2' where"),
        ([".e...", "e0...", ".....", "e1.2e", ".e.e."], None),
        (["....0", ".e0e.", "..e..", "e1.2e", ".e.e."], "'0', '1' or '2' without 'e' beside it"),
        (["e.e..", ".e0e.", "..e..", "e1.2e", ".e.e."], "'e' without '0', '1' or '2' beside it"),
        (["e0...", "0e1..", ".1e2.", "..2e.", "....."], "unconnected parts"),
    ],
)
def test_rules_name_what_is_broken(drawing, said):
    found = broken(drawing)
    assert (found == []) if said is None else any(said in message for message in found), found


def test_a_canvas_without_anything_is_repaired_to_all_three_kinds():
    empty = np.zeros((6, 7), np.int8)
    layout, _ = anneal(empty, Facts(rules(6, 7)), 0, 20_000, empty)
    counts = Counter("".join(grid.draw(layout, TILES)))
    assert audit(layout, rules(6, 7)) == []
    assert min(counts[kind] for kind in "012") >= 1
    # Three stations and one endpoint between them: the cheapest factory changes four cells.
    assert int((layout != 0).sum()) == 4


def test_price_weighs_generated_stations_five_times():
    before = grid.parse(["0.e", "12e"], TILES)
    np.testing.assert_allclose(DOMAIN.similarity_weights(before), [[1, 0.2, 0.2], [1, 1, 0.2]])
    after = grid.parse(["1.e", "12e"], TILES)
    # Sum of p_i over unchanged cells / (n * max p): (5 + 5 + 1 + 1 + 1) / (6 * 5).
    assert float(similarity(before, after, DOMAIN.similarity_weights(before))) == pytest.approx(
        13 / 30
    )


def test_measures_count_stations_and_entropy():
    layout = np.random.default_rng(3).integers(0, 5, (9, 11)).astype(np.int8)
    stations, entropy = (float(measure.value(layout, None)) for measure in DOMAIN.measures)
    windows = Counter(layout[r : r + 2, c : c + 2].tobytes() for r in range(8) for c in range(10))
    expected = -sum(n / 80 * math.log(n / 80, 5**4) for n in windows.values())
    assert stations == np.isin(layout, [1, 2, 3]).sum()
    assert entropy == pytest.approx(expected, abs=1e-6)
    axes = [(axis.low, axis.high, axis.cells) for axis in DOMAIN.measures]
    assert axes == [(0, 600, 100), (0, 1, 100)]


def oracle_weights(layout: np.ndarray, kind: int) -> np.ndarray:
    weights = np.zeros(layout.shape)
    for row, col in np.argwhere(layout == TILES.index("e")):
        for dr, dc in grid.MOVES:
            r, c = row + dr, col + dc
            inside = 0 <= r < layout.shape[0] and 0 <= c < layout.shape[1]
            weights[row, col] += inside and layout[r, c] == 1 + kind
    return weights


PUBLISHED = make_domain(ManufacturingConfig(goal_odds="stations"))


def test_goals_are_the_endpoints_beside_stations():
    layout = np.random.default_rng(5).integers(0, 5, (8, 9)).astype(np.int8)
    for kind, goals in enumerate(
        zip(DOMAIN.simulator.tasks.cycle, PUBLISHED.simulator.tasks.cycle, strict=True)
    ):
        beside = oracle_weights(layout, kind)
        assert beside.max() > 1
        np.testing.assert_array_equal(goals[0].weight(layout), beside > 0)
        np.testing.assert_array_equal(goals[1].weight(layout), beside)
    assert [goal.stay for goal in DOMAIN.simulator.tasks.cycle] == [2, 5, 10]


@pytest.mark.slow
@pytest.mark.parametrize(("domain", "share"), [(DOMAIN, 1 / 2), (PUBLISHED, 2 / 3)])
def test_an_endpoint_between_two_stations_is_as_likely_as_the_odds_say(domain, share):
    layout = grid.parse(["0e0.e0", "1e.2e."], TILES)
    table = planner.goal_table(layout, domain.simulator.tasks, 8)
    assert bool(table.complete)
    draws = planner.draw_goals(table, np.zeros(6000, np.int32), jnp.uint32(0))
    cells = Counter(np.asarray(table.cells)[np.asarray(draws)].tolist())
    assert set(cells) == {1, 4}  # the e between two zeros and the e beside one
    assert cells[1] / 6000 == pytest.approx(share, abs=0.02)  # three standard deviations


def test_presets_state_the_paper_and_a_quick_look():
    paper, quick = find_preset("manufacturing").evaluation, find_preset("manufacturing-quick")
    small = quick.evaluation.domain
    assert isinstance(paper.domain, ManufacturingConfig) and isinstance(small, ManufacturingConfig)
    assert (paper.domain.rows, paper.domain.cols, paper.generator.steps) == (33, 36, 50)
    assert (paper.domain.fleet.agents, paper.domain.fleet.timesteps) == (200, 1000)
    assert (paper.simulations, paper.alpha, paper.domain.stays) == (5, 5.0, (2, 5, 10))
    assert quick.evaluations * small.fleet.timesteps <= 120_000


def test_the_generator_starts_from_the_block_of_figure_9():
    assert DOMAIN.seed_block == ("eeee", "0221", "eeee")


@pytest.mark.parametrize(
    "name", ["manufacturing_nca_a5", "manufacturing_human", "manufacturing_human_eval"]
)
def test_published_layouts_obey_the_rules(name, published):
    assert broken(json.loads(published(name).read_text())["layout"]) == []


def test_our_own_layout_obeys_the_rules_and_the_unrepaired_one_does_not(own_layout):
    assert broken(json.loads(own_layout("manufacturing").read_text())["layout"]) == []
    assert broken(json.loads(own_layout("manufacturing_unrepaired").read_text())["layout"])
