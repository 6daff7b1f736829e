"""Facts about a plan: lines of TOML above the drawing or beside it, and what qdenv writes there."""

from pathlib import Path

import pytest
from conftest import facts_of

from qdenv.cli.main import run
from qdenv.configurations import find_preset
from qdenv.grid import draw
from qdenv.ops.options import Fleet, read_plan
from qdenv.ops.output import Layout
from qdenv.study.plans import resolve_plan

pytestmark = pytest.mark.usefixtures("folder")
DRAWN = ["P.........", "..eSe.eSe.#", "..eSe.eSe.i", "o........."]
TILES = ["w.........#", "..e@e.e@e.#", "..e@e.e@e.i", "o.........#"]
LEGEND = 'legend = {S = "@", P = "w"}'
FACTS = f"""{LEGEND}
robots = 5
cell = 1.2
seconds_per_step = 1.5
shelves = "3:5"
keep = "0:2,0:6"
"""


def save(name="plan.txt", facts=FACTS, rows=DRAWN):
    above = f"+++\n{facts}\n+++\n\n" if facts is not None else ""
    Path(name).write_text(above + "\n".join(rows) + "\n")
    return name


@pytest.mark.parametrize("beside", [False, True])
def test_facts_above_or_beside_a_plan_are_its_own(beside):
    if beside:
        save(facts=None)
        Path("plan.toml").write_text(FACTS)
    else:
        save()
    plan = read_plan("plan.txt")
    assert draw(plan.layout, plan.domain.tiles) == TILES and plan.domain.name == "hall"
    assert (plan.facts.robots, plan.facts.cell) == (5, 1.2)
    # The first rows and columns stay beside walls and stations.
    assert plan.keep == ("w.....????#", "..e@e.????#", "??????????i", "o?????????#")
    domain = plan.fitted()
    assert domain.config.keep == plan.keep
    assert domain.rules().counts[0] == ("@", 3, 5)
    assert plan.fitted({"shelves": 4}).rules().counts[0] == ("@", 4, 4)


def test_what_is_above_counts_more_than_what_is_beside():
    save(facts=f"{LEGEND}\nrobots = 5")
    Path("plan.toml").write_text('robots = 9\ndomain = "hall"')
    assert read_plan("plan.txt").facts.robots == 5


def test_facts_are_defaults_and_options_win():
    save()
    fast = ["--timesteps", "20", "--seeds", "1", "--effort", "low", "--no-verdict"]
    facts = facts_of("simulate", "plan.txt", *fast)
    assert facts["agents"] == 5
    assert facts["tasks_per_hour"] == pytest.approx(facts["mean_throughput"] * 2400)
    facts = facts_of("simulate", "plan.txt", "--agents", "3", "--seconds-per-step", "3", *fast)
    assert facts["agents"] == 3
    assert facts["tasks_per_hour"] == pytest.approx(facts["mean_throughput"] * 1200)
    assert Fleet({}).per_hour is None
    for stated, robots, bounds in (
        ({}, 5, (3, 2)),
        ({"agents": 2, "shelves": 4}, 2, (4, 0)),
        ({"shelves": "2:6"}, 5, (2, 4)),
    ):
        config, _ = resolve_plan(find_preset("quick"), stated, read_plan("plan.txt"))
        domain = config.evaluation.domain
        assert domain.fleet.agents == robots
        assert (domain.shelves, domain.spare_shelves) == bounds


def test_files_that_keep_is_drawn_in_lie_beside_the_plan(folder):
    (folder / "hall").mkdir()
    save("hall/plan.txt", 'keep = "fixed.txt"', TILES)
    Path("hall/fixed.txt").write_text("\n".join(["!" + "?" * 10] + ["?" * 11] * 3))
    assert read_plan("hall/plan.txt").keep == ("w??????????", *["?" * 11] * 3)


@pytest.mark.parametrize("ending", [".txt", ".csv"])
def test_results_in_text_remember_what_must_stay(ending):
    save(facts=None, rows=TILES)
    repair = ["repair", "plan.txt", "--polish", "none", "--shelves", "2:3"]
    assert run([*repair, "--keep", "0:2,0:6", "--out", f"new{ending}"]) == 0
    assert read_plan(f"new{ending}").keep[0] == "w.....????#"
    assert read_plan(f"new{ending}").fitted().rules().counts[0] == ("@", 2, 3)
    assert run(["check", f"new{ending}", "--shelves", "3"]) == 0
    # What is found without: nothing is beside it.
    assert run([*repair[:-1], "3", "--out", f"plain{ending}"]) == 0
    assert not Path("plain.toml").exists()
    even = ["layout", "human", "--rows", "9", "--cols", "12", "--out", f"even{ending}"]
    assert run(even) == 0
    assert read_plan(f"even{ending}").domain.name == "warehouse-even"


def test_a_file_of_hers_is_not_replaced():
    save(facts=None, rows=TILES)
    Path("new.toml").write_text("robots = 3")
    assert run(["repair", "plan.txt", "--keep", "0:2,0:6", "--out", "new.txt"]) == 0
    assert Path("new.toml").read_text() == "robots = 3"


def test_what_a_format_cannot_hold_is_logged(caplog):
    caplog.set_level("INFO", "qdenv")
    save()
    plan = read_plan("plan.txt")
    Layout(plan.layout, plan.fitted()).save("plan.grid")
    assert any("tells" in line and "apart" in line for line in caplog.messages), caplog.messages


@pytest.mark.parametrize(
    ("facts", "reason"),
    [
        ("robots = ", "plan.txt: cannot be read (not TOML"),
        ("robots = 0", "robots must be at least 1, not 0"),
        ('robots = "many"', 'robots: must be a whole number or null, not "many"'),
        ("cell = -1", "cell must be above 0"),
        ("robot = 3", "unknown fact 'robot': did you mean robots?"),
        ('legend = {SS = "@"}', "one sign stands for one tile"),
        ('legend = {S = "q", P = "w"}', "unknown tile 'q'"),
        ("legend = {S = 3}", "legend['S']: must be a word"),
        ('shelves = "5:3"', "write 1100, or a range from few to many like 1000:1200"),
        ("shelves = true", "shelves: must be"),
        ("shelves = 99", "no repair exists"),
        ('keep = "zz"', "keep 'zz': give tiles like w#"),
        ('drawing = ["??"]', "has 1 x 2 cells, the layout 4 x 11"),
        ('domain = "moon"', "the file says domain 'moon', which is unknown"),
        ("rows = 3", "unknown fact 'rows'"),
        ("fleet = 3", "unknown fact 'fleet'"),
        ('around = [".."]', "unknown fact 'around'"),
        ("x = " + "[" * 5000, "not TOML"),
        ("+++", "one line +++ begins facts, a second one ends them"),
    ],
)
def test_a_mistake_in_the_facts_is_one_line(facts, reason, capsys):
    rows = TILES if "legend" not in facts else DRAWN
    assert run(["repair", save(facts=facts, rows=rows)]) == 2
    said = capsys.readouterr().err
    assert reason in said and said.count("\n") == 1, said
    assert not Path("plan_repaired.json").exists()


def test_settings_of_the_hall_are_facts():
    Path("odds.csv").write_text("\n".join(["0" + ",1" * 10] * 4))
    settings = save(facts='pick = 2\ndrop = 5\nshares = "w=1,o=3"\ndemand = "odds.csv"', rows=TILES)
    config = read_plan(settings).domain.config
    assert (config.pick, config.drop, config.shares) == (2, "5", "w=1,o=3")
    assert config.demand[0].startswith("0 1")
    save(facts='drop = "q=5"', rows=TILES)
    assert run(["check", "plan.txt"]) == 2


def test_facts_of_other_domains():
    rows = ["e0e.", "e1e.", "e2e."]
    plan = read_plan(save(facts="stays = [1, 2, 3]", rows=rows))
    assert plan.domain.name == "manufacturing" and plan.domain.config.stays == (1, 2, 3)
    save(facts="shelves = 3", rows=rows)
    assert run(["check", "plan.txt"]) == 2
    facts = 'domain = "warehouse-even"\nshelves = "3"'
    plan = read_plan(save(facts=facts, rows=["w.......w"] * 5))
    assert plan.fitted().config.shelves == 3, "a number in quotes is one"


def test_converted_text_has_no_facts_of_an_older_plan_of_its_name(capsys):
    save("small.txt", None, ["w....", ".eee.", ".@@@.", ".eee.", "....."])
    save(facts=None, rows=TILES)
    assert run(["convert", "small.txt", "new.txt", "--cell", "2"]) == 0
    assert read_plan("new.txt").facts.cell == 2
    assert run(["convert", "plan.txt", "new.txt"]) == 0
    assert "new.toml (replaced)\n" in capsys.readouterr().out
    assert read_plan("new.txt").facts.cell is None
    # Facts that people wrote stay.
    Path("own.toml").write_text("cell = 1.2\n")
    assert run(["convert", "small.txt", "own.csv", "--cell", "3"]) == 0
    assert "own.toml is not of qdenv: not replaced\n" in capsys.readouterr().out
    assert Path("own.toml").read_text() == "cell = 1.2\n"
