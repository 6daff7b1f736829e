"""Halls of any shape, walls and stations where the plan has them; the warehouse is one."""

import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import read_layout

import qdenv
from qdenv import score
from qdenv.cli.main import run
from qdenv.domains.base import find_domain, make_domain
from qdenv.domains.hall import HallConfig
from qdenv.grid import draw, parse
from qdenv.repairs.audit import audit
from qdenv.repairs.recipe import repair_layout
from qdenv.repairs.settings import RepairConfig
from qdenv.simulation.mapf.settings import FleetConfig
from qdenv.study.elites import tile
from qdenv.study.plans import read_plan, with_tasks
from qdenv.types import InputError

# An L with columns, stations of three kinds, and lines that end where the building does.
ROWS = (
    "w.......",
    "..e@e.#.",
    "..e@e...i....",
    "o............",
    "..e@e.",
    "..e@e.##",
    "w.....##",
)
HALL = find_domain("hall")


def save(path, rows=ROWS):
    path.write_text("\n".join(rows) + "\n")
    return path


def finished(domain, layout, seed):
    """Count the tasks that 12 robots finish at each of 60 timesteps."""
    config = dataclasses.replace(domain.config, fleet=FleetConfig(agents=12, timesteps=60))
    simulator = make_domain(config).simulator
    return np.asarray(simulator.run(simulator.prepare(layout), jax.random.key(seed)).finished)


@pytest.mark.parametrize("ending", [".txt", ".csv"])
def test_short_lines_and_blanks_are_outside(ending, tmp_path):
    rows = [",".join(row.replace(" ", "")) for row in ROWS] if ending == ".csv" else ROWS
    plan = read_plan(save(tmp_path / f"l{ending}", rows))
    assert plan.domain.name == "hall" and plan.layout.shape == (7, 13)
    assert draw(plan.layout, HALL.tiles)[0] == "w.......#####"
    blanks = [row.ljust(13) for row in ROWS]
    np.testing.assert_array_equal(plan.layout, read_plan(save(tmp_path / "b.txt", blanks)).layout)
    assert not plan.domain.drivable(plan.layout)[0, 8:].any()


def test_other_domains_and_json_pad_nothing(tmp_path):
    path = save(tmp_path / "short.txt", ["e0e", "e"])
    with pytest.raises(InputError, match="make all rows equally long"):
        read_plan(path, "manufacturing")
    path = tmp_path / "short.json"
    path.write_text('["w@e", "e"]')
    with pytest.raises(InputError, match="make all rows equally long"):
        read_plan(path)


def test_walls_and_stations_stay_through_frame_and_repair(tmp_path):
    plan = read_plan(save(tmp_path / "l.txt"))
    domain, rules = plan.fitted({"shelves": 9}), plan.fitted({"shelves": 9}).rules()
    fixed, rng = plan.layout >= len(HALL.generated), np.random.default_rng(0)
    fixed[2:4, 12] = True  # the way out at the right
    assert fixed.sum() == 38 and audit(plan.layout, plan.fitted().rules()) == []
    for seed in range(3):
        area = rng.integers(0, 3, plan.layout.shape).astype(np.int8)
        framed = np.asarray(domain.frame(area))
        np.testing.assert_array_equal(framed, np.where(fixed, plan.layout, area))
        repaired = np.asarray(repair_layout(framed, rules, seed, RepairConfig("none")).layout)
        assert audit(repaired, rules) == []
        np.testing.assert_array_equal(repaired[fixed], plan.layout[fixed])
        assert (repaired >= len(HALL.generated)).sum() == 36 and (repaired == 1).sum() == 9


def test_a_hall_needs_a_station():
    layout = parse(["..e@", "...."], HALL.tiles)
    (broken,) = audit(layout, HALL.fitted(layout).rules())
    assert "0 workstations, inbound stations or outbound stations where" in broken.message


@pytest.mark.slow
def test_the_papers_warehouse_is_a_hall_with_a_frame(own_layout):
    even = find_domain("warehouse-even")
    layout = read_layout(own_layout("warehouse_even"), even.tiles)
    for seed in (0, 7):
        both = [finished(one.fitted(layout), layout, seed) for one in (HALL, even)]
        assert both[0].sum() > 10
        np.testing.assert_array_equal(*both)


def test_the_entropy_counts_patterns_of_what_is_drawn_alone():
    drawn = parse([".@e.", "@@e.", ".ee."], HALL.tiles)
    walled = np.pad(drawn, 2, constant_values=HALL.tiles.index("#"))
    plain = score.entropy(jnp.asarray(drawn), 3)
    assert float(score.entropy(jnp.asarray(walled), 3, partial=True)) == float(plain) > 0
    assert float(score.entropy(jnp.full((4, 4), 4), 3, partial=True)) == 0


@pytest.mark.parametrize("shape", [(7, 13), (60, 80)])
def test_measures_reach_from_end_to_end_at_any_size(shape):
    domain = HALL.resized(*shape)
    components, entropy = domain.measures
    assert (components.low, components.high) == (0, domain.config.shelves)
    assert (entropy.low, entropy.high) == (0, 1)


@pytest.mark.slow
@pytest.mark.parametrize(
    "line",
    ["train quick --domain hall", "generate run --rows 9 --cols 30", "series run"],
)
def test_without_a_plan_a_hall_has_no_stations(line, capsys, folder):
    save(Path("l.txt"))
    small = "--agents 4 --timesteps 9 --simulations 1 --steps 6 --hidden 4 --emitters 1 --batch 4"
    if "run" in line:
        train = ["train", "quick", "--plan", "l.txt", *small.split(), "--evaluations", "4"]
        assert run([*train, "--no-progress", "--out", "run"]) == 0
    capsys.readouterr()
    assert run(line.split()) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "come from a plan: `train` and `generate` take --plan" in said


def test_a_tiled_hall_repeats_walls_and_stations(tmp_path):
    plan = read_plan(save(tmp_path / "l.txt", ["..e@", "w.@e", "...#"]))
    larger = tile(plan, (6, 8), config=RepairConfig("none")).layout
    kinds = [(larger == kind).sum() for kind in range(3, 5)]
    assert kinds == [4, 4] and audit(larger, HALL.fitted(larger).rules()) == []


def test_aisles_and_racks_are_settings_that_check_and_repair_take(tmp_path):
    path = save(tmp_path / "hall.txt")
    broken = [one.message for one in qdenv.check(path, aisle=2, rack="1x3")]
    assert broken[-2:] == [
        "aisle narrower than 2 cells: 3 cells, the first at row 0, column 3",
        "shelf in no rack of 1 x 3: 4 cells, the first at row 1, column 3",
    ]
    made = qdenv.repair(path, polish="none", shelves=6, aisle=2, rack="1x3")
    fitted = read_plan(path).fitted({"shelves": 6, "aisle": 2, "rack": "1x3"})
    assert audit(made.layout, fitted.rules()) == []
    assert audit(made.layout, fitted.resized(7, 13, {"aisle": 4}).rules())


def test_straight_aisles_and_both_sides_are_rules_of_a_hall(tmp_path, capsys):
    path = str(save(tmp_path / "hall.txt"))
    rules = ["--cross-aisle", "1", "--both-sides"]
    assert run(["check", path, *rules, "--rack", "1x2"]) == 1
    said = capsys.readouterr().out
    place = "4 cells, the first at row 1, column 3"
    assert f"shelves in 2 or more rows without a straight aisle: {place}" in said
    assert "holds: every shelf in a rack of 1 x 2\n" in said
    assert "holds: every shelf in a rack with aisles on both sides\n" in said
    made = str(tmp_path / "made.txt")
    assert run(["repair", path, *rules, "--out", made]) == 0
    assert run(["check", made]) == 0  # what it was repaired by is beside it
    holds = "holds: a straight aisle among any 2 successive rows or columns"
    assert holds in capsys.readouterr().out


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"rack": "2by3"}, "rack '2by3': give rows and columns like 2x6"),
        ({"rack": (2, 6)}, r"rack \(2, 6\): give rows and columns like 2x6"),
        ({"rack": "2x9"}, "be at least 4 but racks of 2 x 9 have room for at most 0"),
        ({"aisle": 0}, "aisle must be at least 1, not 0"),
    ],
)
def test_aisles_and_racks_that_cannot_be_are_refused(settings, message, tmp_path):
    with pytest.raises(InputError, match=message):
        qdenv.repair(save(tmp_path / "hall.txt"), **settings)


@pytest.mark.slow
def test_generators_draw_racks_into_a_plan(folder):
    save(Path("l.txt"))
    line = "generate zoo:warehouse-even/best --plan l.txt --aisle 2 --rack 1x2 --out made.txt"
    assert run(line.split()) == 0
    assert run(["check", "made.txt", "--aisle", "2", "--rack", "1x2"]) == 0


def test_each_shelf_has_the_same_share_whatever_serves_it():
    rows = ["w....", ".eee.", ".@@..", ".e..."]
    hall = make_domain(HallConfig(rows=4, cols=5, shelves=2, demand=("shelves",)))
    layout = parse(rows, hall.tiles)
    weights = hall.simulator.tasks.cycle[0].weight(layout)
    # The left shelf has endpoints above and below, the right one above only; one serves neither.
    expected = np.zeros((4, 5), np.float32)
    expected[1, 1] = expected[3, 1] = 6
    expected[1, 2] = 12
    np.testing.assert_array_equal(weights, expected)
    jitted = jax.jit(hall.simulator.tasks.cycle[0].weight)(layout)
    np.testing.assert_array_equal(jitted, expected)


def test_demand_of_shelves_is_a_word_that_fits_every_size(tmp_path):
    path = tmp_path / "hall.txt"
    path.write_text("w....\n.eee.\n.@@..\n.....\n")
    plan = with_tasks(qdenv.read_plan(path), {"demand": "shelves"})
    assert plan.domain.config.demand == ("shelves",)
    assert plan.fitted().resized(8, 10).config.demand == ("shelves",)


def test_doors_stay_open(tmp_path):
    path = tmp_path / "hall.txt"
    path.write_text("###..###\n#w.ee..#\n...@@...\n#......#\n#......#\n###e####\n")
    keep = qdenv.read_plan(path).fitted().config.keep
    assert keep == ("###..###", "#w?????#", ".??????.", "#??????#", "#??????#", "###e####")
    path.write_text("w.......\n...ee...\n...@@...\n#......#\n")  # an open side is no door
    assert qdenv.read_plan(path).fitted().config.keep[0] == "w" + "?" * 7
