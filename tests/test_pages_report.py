"""The report: its numbers are those of the other commands, it opens and prints without a flaw."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from conftest import facts_of
from matplotlib.figure import Figure
from small_warehouse import ROWS, TILES

import qdenv
from qdenv.cli.main import run
from qdenv.domains.base import find_domain
from qdenv.grid import parse
from qdenv.guidance import crisscross
from qdenv.io.layouts import write_layout
from qdenv.simulation.mapf.settings import FleetConfig, PibtConfig
from qdenv.study.plans import Plan, read_plan
from qdenv.study.table import Row, decide
from qdenv.types import InputError
from qdenv.view.page import listed
from qdenv.view.report_fleet import make_request, report_fleet
from qdenv.view.report_subjects import Subject, find_rival
from qdenv.view.style import to_svg

pytestmark = pytest.mark.slow

QUICK = ["--planner", "pibt", "--timesteps", "120", "--seeds", "4"]
WAREHOUSE = find_domain("warehouse-even")
PIBT = PibtConfig()
HEADINGS = [
    "In short",
    "The floor plan",
    "Throughput against robots",
    "Where robots wait",
    "Finished tasks over time",
    "Against the hand-made floor plan",
    "Appendix: how this was measured",
    "Appendix: throughput",
    "Appendix: against the hand-made floor plan",
    "Appendix: where robots wait",
    "Appendix: settings and versions",
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a plan of 7 x 11, the hand-made one of that size, and a maze."""
    place = tmp_path_factory.mktemp("reports")
    write_layout(place / "plan.json", parse(ROWS, TILES), TILES, domain="warehouse-even")
    human = WAREHOUSE.resized(7, 11).human()
    write_layout(place / "hand-made.json", human, TILES, domain="warehouse-even")
    (place / "maze.txt").write_text("XXXXXX\nX    X\nX XX X\nX X  X\nXXXXXX\n")
    return place


@pytest.fixture(scope="module")
def facts(folder):
    """The facts of a report on the plan with 12 robots, and of the commands it stands for."""
    command = ["--agents", "12", *QUICK]
    plan, human = str(folder / "plan.json"), str(folder / "hand-made.json")
    other = {
        "report": ["report", plan, "--out", str(folder / "r.html"), *command],
        "simulate": ["simulate", plan, *command],
        "sweep": ["sweep", plan, "--out", str(folder / "s.csv"), *command],
        "compare": ["compare", human, plan, "--out", str(folder / "c.csv"), *command],
    }
    other["sweep"][other["sweep"].index("12")] = "6:18:3"
    return {name: facts_of(*line) for name, line in other.items()}


def cells(shown, table):
    """Read a table of the page as people do."""
    rows = f"[...document.querySelectorAll('#{table} tbody tr')]"
    return shown.evaluate(f"{rows}.map(row => [...row.cells].map(cell => cell.innerText))")


def test_its_facts_are_those_of_simulate_sweep_and_compare(facts):
    report, own = facts["report"], facts["report"]["layouts"]["plan"]
    for name, value in facts["simulate"].items():
        if name in own and "seconds" not in name:
            assert own[name] == value, name
    assert {"runs", "verdict", "evidence", "worst_cells", "mean_of_all"} <= set(own)

    def timeless(rows):
        return [{k: v for k, v in row.items() if "cpu" not in k} for row in rows]

    rows = [row for row in report["rows"] if row["layout"] == "plan"]
    assert timeless(rows) == timeless(facts["sweep"]["rows"])
    assert [row["agents"] for row in rows] == [6, 9, 12, 15, 18]
    against = next(row for row in facts["compare"]["rows"] if row["layout"] == "plan")
    found = next(one for one in own["hand_made"]["differences"] if one["agents"] == 12)
    for name in ("percent", "low", "high"):
        assert found[name] == against[f"difference_{name}"]


def test_the_page_shows_these_numbers_and_complains_of_nothing(folder, facts, opened):
    sweep, simulate = facts["sweep"]["rows"], facts["simulate"]
    with opened(folder / "r.html") as shown:
        about = ("command", "qdenv", "settings")
        assert shown.evaluate("facts") == {
            name: value for name, value in facts["report"].items() if name not in about
        }
        headings = shown.evaluate("[...document.querySelectorAll('h2')].map(h => h.innerText)")
        throughput = cells(shown, "throughput")
        against, waiting = cells(shown, "against-0"), cells(shown, "waiting-0")
        answer, text = shown.inner_text("p.answer"), shown.inner_text("main")
        aligned = shown.evaluate(
            "[...document.querySelectorAll('#throughput tbody tr:first-child td')]"
            ".map(cell => getComputedStyle(cell).textAlign)"
        )
    assert headings == HEADINGS and "(seeds 0 to 3)" in text
    assert "No run congested" in text and "never congested" not in text
    assert aligned == ["left", *["right"] * 4]
    for row, line in zip(sweep, throughput, strict=False):
        assert line[:3] == ["plan", str(row["agents"]), f"{row['mean_of_all']:.3f}"]
        assert line[4] == f"{row['error_of_all']:.3f}"
    counts = [str(row["agents"]) for row in sweep]
    assert [line[:2] for line in throughput[5:]] == [["hand-made", count] for count in counts]
    spots = [[str(spot["row"]), str(spot["column"])] for spot in simulate["worst_cells"]]
    assert [line[1:3] for line in waiting] == spots
    differences = facts["report"]["layouts"]["plan"]["hand_made"]["differences"]
    assert [line[3] for line in against] == [f"{one['percent']:+.1f} %" for one in differences]
    assert f"With 12 robots it moves {simulate['mean_of_all']:.2f} tasks per timestep" in answer
    assert simulate["verdict_reason"].replace("agent", "robot") in answer


def test_on_paper_no_figure_is_higher_than_a_page_and_headings_stay_with_theirs(
    folder, facts, opened
):
    with opened(folder / "r.html", width=700) as shown:
        shown.emulate_media(media="print")
        heights = shown.evaluate(
            "[...document.querySelectorAll('figure')].map(f => f.getBoundingClientRect().height)"
        )
        kept = shown.evaluate(
            "[...document.querySelectorAll('figure, .lead, tr')]"
            ".map(block => getComputedStyle(block).breakInside)"
        )
        printed = shown.pdf(format="A4")
    assert len(heights) == 6 and max(heights) < 500  # of 970 on the shorter of A4 and Letter
    assert set(kept) == {"avoid"}
    assert 4 <= printed.count(b"/Type /Page\n") <= 8
    assert (folder / "r.html").stat().st_size < 1e6


def test_a_floor_with_guidance_shows_it_and_who_obeys(folder, tmp_path, opened):
    assert "guidance" not in (folder / "r.html").read_text()
    plan = read_plan(folder / "plan.json")
    guided = plan._replace(costs=crisscross(plan.layout != TILES.index("@")))
    subject = Subject("guided", "guided.json", guided)
    request = make_request([subject], (6,), 40, lambda *one: FleetConfig(*one, planner=PIBT), (0,))
    page = report_fleet(request)
    with opened(page.save(tmp_path / "guided.html")) as shown:
        arrows = shown.locator("#plan-0-guidance")
        assert arrows.is_visible() and shown.locator("#flow-0-axes_1").count() == 1
        shown.locator("#guidance").click()
        assert not arrows.is_visible() and shown.locator("#guidance").is_visible()
        assert "of their moves take the way that guidance makes cheaper" in shown.inner_text("main")


def test_several_layouts_and_numbers_look_closely_at_the_peak_of_the_first(folder, capsys, opened):
    sources = [str(folder / "hand-made.json"), str(folder / "plan.json")]
    line = ["--agents", "3,9,30", *QUICK, "--seconds-per-step", "0.5", "--json", "-"]
    assert run(["report", *sources, *line, "--out", str(folder / "two.html")]) == 0
    facts = json.loads(capsys.readouterr().out)
    first = [row for row in facts["rows"] if row["layout"] == "hand-made"]
    assert len(facts["rows"]) == 6  # what people draw by hand is there already
    peak = max(first, key=lambda row: row["mean_of_all"])
    assert facts["agents"] == peak["agents"]
    assert all(one["hand_made"] is None for one in facts["layouts"].values())
    (decision,) = facts["decisions"]
    assert (decision["layout"], decision["against"]) == ("plan", "hand-made")
    rows = {row["layout"]: row for row in facts["rows"] if row["agents"] == facts["agents"]}
    ratio = rows["plan"]["mean_of_all"] / rows["hand-made"]["mean_of_all"]
    assert decision["percent"] == pytest.approx(100 * (ratio - 1), rel=1e-4)
    with opened(folder / "two.html") as shown:
        assert cells(shown, "throughput")[0][5] == f"{first[0]['mean_of_all'] * 7200:,.0f}"
        assert shown.inner_text("p.answer strong") == f"{decision['sentence']}."
        hourly = f"plan moves {rows['plan']['mean_of_all'] * 7200:,.0f} tasks an hour"
        assert hourly in shown.inner_text("p.answer")
        assert len(cells(shown, "short")) == 2 and "by hand" not in shown.inner_text("main")
        assert shown.locator("[id^=change-0-]").count() > 0


def row_of(layout, mean, error):
    return Row(layout, 7, 11, 200, 5, mean, error, 1, 0.5, 1, mean, 0.1, error)


@pytest.mark.parametrize(
    ("ours", "theirs", "sentence"),
    [
        ((5.0, 0.1), (4.0, 0.05), r"B moves 25.0 % more than A .* \(95 %: 17.9 to 32.4 %\)"),
        ((3.0, 0.1), (4.0, 0.05), r"B moves 25.0 % less than A .* \(95 %: 18.4 to 31.5 %\)"),
        (
            (4.1, 0.1),
            (4.0, 0.1),
            r"B moves 2.5 % more than A at 200 robots, which may be chance "
            r"\(95 %: \d.\d % less to \d+.\d % more\)",
        ),
        ((1.0, 2.0), (4.0, 1.0), r".* may be chance \(95 %: 100.0 % less to \d+.\d % more\)"),
        ((5.0, np.nan), (4.0, np.nan), r"B moves 25.0 % .* \(too few runs to be sure\)"),
        ((4.0, 0.1), (0.0, 0.0), "A moves nothing at 200 robots, B 4.00 tasks per timestep"),
        ((4.0, 0.1), (4.0, 0.1), "B moves as much as A at 200 robots"),
    ],
)
def test_the_decision_is_one_sentence_with_its_interval(ours, theirs, sentence):
    found = decide(row_of("B", *ours), row_of("A", *theirs))
    assert re.fullmatch(sentence, found["sentence"]), found["sentence"]
    assert "nan" not in found["sentence"] and found["agents"] == 200


def test_one_run_has_no_interval_and_says_none(folder, opened):
    line = ["--agents", "6", "--planner", "pibt", "--timesteps", "40", "--seeds", "7,"]
    assert run(["report", str(folder / "plan.json"), *line, "--out", str(folder / "one.html")]) == 0
    with opened(folder / "one.html") as shown:
        assert {(line[3], line[4]) for line in cells(shown, "throughput")} == {("", "")}
        assert {line[4] for line in cells(shown, "against-0")} == {""}
        assert shown.evaluate("facts.layouts.plan.standard_error") is None
        text = shown.inner_text("main")
    assert "nan" not in text.lower() and "(seed 7)" in text


def test_a_maze_has_the_agents_success_as_evaluate_agent_says_it(folder, opened):
    maze, page = str(folder / "maze.txt"), folder / "maze.html"
    said = facts_of("evaluate-agent", maze)
    facts = facts_of("report", maze, "--out", str(page))["layouts"]["maze"]
    for name in ("rate", "low", "high", "runs", "mean_length", "shortest"):
        assert facts[name] == said[name]
    with opened(page) as shown:
        (row,) = cells(shown, "success")
    assert row[2:4] == [f"{said['rate']:.1%}", f"{said['low']:.1%} to {said['high']:.1%}"]


def test_a_run_shows_its_archive_and_reports_on_its_best_layout(small_run, tmp_path, opened):
    page = qdenv.report(small_run, agents=4, timesteps=60, seeds=2, planner="pibt")
    assert page._repr_html_().startswith("<iframe")
    with opened(page.save(tmp_path / "run.html")) as shown:
        headings = shown.evaluate("[...document.querySelectorAll('h2')].map(h => h.innerText)")
        said = dict(cells(shown, "search-0"))
        assert shown.locator("#archive-0-figure_1, [id^=archive-0]").count() > 0
    assert f"The search: {small_run.path.name}" in headings
    last = small_run.read_metrics()[-1]
    assert said["evaluations"] == f"{last.evaluations:,}"
    assert said["QD-score"] == f"{last.qd_score:,.1f}"


def test_the_hand_made_rival_has_the_same_stations_or_there_is_none(folder):
    plans = [read_plan(folder / name) for name in ("plan.json", "hand-made.json", "maze.txt")]
    plan, human, maze = (Subject(one.name, one.name, one) for one in plans)
    rival = find_rival(plan, [plan])
    assert rival.plan.name == "hand-made"
    assert np.array_equal(rival.plan.layout, human.plan.layout)
    shelves = [int((one.plan.layout == 1).sum()) for one in (human, plan)]
    assert "with {} shelves, not {}".format(*shelves) in rival.about
    namesake = plan._replace(name="hand-made")
    assert find_rival(namesake, [namesake]).plan.name == "hand-made design"
    assert find_rival(plan, [plan, human]) is None  # compared with each other already
    assert find_rival(human, [human]) is None and find_rival(maze, [maze]) is None
    moved = plan.plan.layout.copy()
    station = TILES.index("w")
    row, column = np.argwhere(moved == station)[0]
    moved[row, column], moved[row + 1, column] = 0, station
    assert find_rival(plan._replace(plan=plan.plan._replace(layout=moved)), [plan]) is None


def test_generators_of_one_domain_are_reported_together():
    page = qdenv.report(["zoo:maze-walls/best", "zoo:maze-walls/open"], timesteps=5)
    assert list(page.facts["layouts"]) == ["maze-walls/best", "maze-walls/open"]


@pytest.mark.parametrize(
    ("agents", "counts"),
    [(200, (100, 150, 200, 250, 300)), (800, (400, 600, 800, 948)), (1, (1, 2)), (2, (1, 2, 3))],
)
def test_numbers_of_robots_are_chosen_around_the_one_in_question(agents, counts):
    plan = Plan("a", WAREHOUSE.human(), WAREHOUSE, False)  # of 948 free cells
    request = make_request([Subject("a", "a.json", plan)], [agents], None, FleetConfig, (0,))
    assert request.counts == counts and request.config.agents == counts[-1]


def test_figures_keep_their_names_apart_and_their_text_as_text():
    figure = Figure()
    figure.add_subplot().set_title("a <title>")
    one, other = (to_svg(figure, name) for name in ("one", "other"))
    assert one.startswith("<svg") and "a &lt;title&gt;" in one
    assert 'id="one-' in one and 'id="' not in one.replace('id="one-', "")
    assert other.count("#other-") == other.count("#") - other.count(": #")


def test_lists_read_as_sentences():
    assert listed(["a"]) == "a" and listed(["a", "b", "c"]) == "a, b and c"


def test_without_a_page_library_nothing_is_simulated(folder, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    monkeypatch.setattr("qdenv.study.engine._program", lambda *how: pytest.fail("simulated"))
    with pytest.raises(InputError, match="pages need jinja2: pip install"):
        qdenv.report([Path(folder / "plan.json")])
