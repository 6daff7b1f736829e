"""`qdenv improve`: what the folder holds, that it goes on, and never calls a worse plan better."""

import json
from pathlib import Path

import numpy as np
import pytest
from conftest import facts_of

import qdenv
from qdenv import interrupt
from qdenv.cli.main import run
from qdenv.domains.base import make_domain
from qdenv.repairs.audit import audit
from qdenv.run.directory import RunDirectory
from qdenv.stats import Difference
from qdenv.study import improve as studies
from qdenv.types import InputError

pytestmark = pytest.mark.slow
# Racks far from the stations, a column between them.
ROWS = [
    "+++",
    "robots = 4",
    "seconds_per_step = 1.5",
    "cell = 1.2",
    'keep = "0:1,0:15"',
    "+++",
    "w..............",
    "w..........eee.",
    "...........@@@.",
    "w.....#........",
    "...............",
]
QUICK = {"timesteps": 40, "planner": "pibt", "progress": False}
SHORT = ["--timesteps", "40", "--planner", "pibt", "--no-progress"]


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    path = tmp_path_factory.mktemp("plan") / "hall.txt"
    path.write_text("\n".join(ROWS) + "\n")
    return path


@pytest.fixture(scope="module")
def done(plan, tmp_path_factory):
    """One search of the four, for the whole module: each compiles for ten seconds."""
    folder = tmp_path_factory.mktemp("improve") / "better"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(studies, "SECTIONS", {"floor": studies.SECTIONS["floor"]})
        yield qdenv.improve(plan, path=folder, evaluations=128, **QUICK), folder


def test_a_better_floor_is_found_and_written_as_the_plan_came(done, plan):
    table, folder = done
    rows = {(row.section, row.agents): row for row in table}
    best = rows["floor", 4]
    assert best.better and best.percent > 10 and best.low > 0
    for picture in ("a_new_floor.png", "racks_moved.png"):
        assert (folder / picture).stat().st_size > 10_000
    # Shelves by the stations are as good where their number of endpoints does not count.
    assert best.by_shelf > 10 and rows["floor", 5].by_shelf is None
    written = folder / "a_new_floor.txt"
    assert run(["check", str(written), "--shelves", "3"]) == 0
    before, after = qdenv.read_plan(plan), qdenv.read_plan(written)
    kinds = [before.domain.tiles.index(tile) for tile in before.domain.tiles if tile in "w#"]
    np.testing.assert_array_equal(np.isin(before.layout, kinds), np.isin(after.layout, kinds))


def test_rules_of_a_hall_that_is_built_hold_in_racks_in_rows(plan, tmp_path, monkeypatch):
    monkeypatch.setattr(studies, "SECTIONS", {"rows": ("racks in rows", 0.3)})
    folder = tmp_path / "wide"
    qdenv.improve(plan, path=folder, evaluations=64, aisle=2, rack="1x3", **QUICK)
    found = RunDirectory.open(folder / "rows")
    rules = make_domain(found.config.evaluation.domain).rules()
    assert [cover.shapes for cover in rules.covers] == [((2, 2),), ((1, 3), (3, 1))]
    layouts = found.archive.columns["repaired"]
    assert len(layouts) and not any(audit(layout, rules) for layout in layouts)


def test_what_is_not_better_is_not_written(done):
    table, folder = done
    names = {section: title.replace(" ", "_") for section, (title, _) in studies.SECTIONS.items()}
    for row in table:
        assert (folder / f"{names[row.section]}.txt").exists() == row.better


def test_a_folder_of_other_settings_or_files_is_refused(done, plan):
    _, folder = done
    with pytest.raises(InputError, match="other settings"):
        qdenv.improve(plan, path=folder, evaluations=129, **QUICK)
    with pytest.raises(InputError, match="holds another plan"):
        qdenv.improve(plan, path=folder, evaluations=128, guidance="crisscross", **QUICK)
    with pytest.raises(InputError, match="something else"):
        qdenv.improve(plan, path=plan.parent, evaluations=128, **QUICK)


def test_impossible_rules_are_refused_before_anything_is_written(plan, tmp_path):
    with pytest.raises(InputError, match="no layout obeys all rules: the number of shelves must"):
        qdenv.improve(plan, path=tmp_path / "new", evaluations=1, shelves="900", **QUICK)
    assert list(tmp_path.iterdir()) == []


def test_a_plan_whose_format_cannot_hold_its_tiles_becomes_json(tmp_path, monkeypatch):
    monkeypatch.setattr(studies, "SECTIONS", {})
    floor = "map\nE...\n.@S.\n.@S.\nE...\n"  # a map of the League of Robot Runners
    (tmp_path / "league.map").write_text(f"type octile\nheight 4\nwidth 4\n{floor}")
    new = tmp_path / "new"
    qdenv.improve(tmp_path / "league.map", 2, new, evaluations=1, **QUICK)
    assert json.loads((new / "improve.json").read_text())["ending"] == ".json"


def test_only_the_searches_of_an_improvement_go_on_with_it(done):
    other = done[1] / "another"
    other.mkdir()
    with pytest.raises(InputError, match=r"another: no run here \(config.json is missing\)"):
        qdenv.resume(other)
    other.rmdir()
    with pytest.raises(
        InputError, match=r"no run here \(config.json is missing\); choose one of those in it: f"
    ):
        qdenv.RunDirectory.open(done[1])


def test_costs_of_moves_that_are_stated_by_name_are_part_of_the_plan(plan, tmp_path, monkeypatch):
    monkeypatch.setattr(studies, "SECTIONS", {})
    qdenv.improve(plan, path=tmp_path / "lanes", evaluations=1, guidance="crisscross", **QUICK)
    assert qdenv.read_plan(tmp_path / "lanes" / "plan.json").costs is not None


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"name": None}, "must be a word"),
        ({"ending": "/../../x.json"}, "ending: must be one of"),
        ({}, r"improve\.csv: is a link"),
    ],
)
def test_a_foreign_folder_writes_nowhere_else(changes, message, done, tmp_path):
    _, folder = done
    names = ("improve.json", "plan.json")
    settings, plan = (json.loads((folder / name).read_text()) for name in names)
    (tmp_path / "improve.json").write_text(json.dumps(settings | changes))
    (tmp_path / "plan.json").write_text(json.dumps(plan))
    (tmp_path / "improve.csv").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(InputError, match=message):
        qdenv.resume(tmp_path)
    assert not (tmp_path / "elsewhere").exists()


def test_a_planner_that_knows_no_costs_judges_none(done, plan):
    found = studies.list_candidates(qdenv.read_plan(plan), done[1], "floor", None)
    assert found and all(one.costs is None for one in found)


def test_an_hour_of_an_engineer(done, plan, folder):
    """No command needs an option from her plan, nor from what the one before wrote."""
    better = str(done[1] / "a_new_floor.txt")
    for layout in (str(plan), better):
        assert run(["check", layout]) == 0
        facts = facts_of("simulate", layout, *SHORT[:-1], "--seeds", "2", "--no-verdict")
        assert facts["agents"] == 4
        assert facts["tasks_per_hour"] == pytest.approx(2400 * facts["mean_throughput"])
    assert qdenv.read_plan(better).fitted().config.keep[0] == "w" + "." * 14
    assert "tasks an hour" in (done[1] / "report.html").read_text()
    assert run(["convert", better, "hall.lif"]) == 0
    (drawn,) = json.loads(Path("hall.lif").read_text())["layouts"]
    assert drawn["nodes"][0]["nodePosition"] == {"x": 0.6, "y": 5.4}
    assert run(["convert", better, "copy.csv"]) == 0
    assert qdenv.read_plan("copy.csv").facts.details == qdenv.read_plan(plan).facts.details


def test_interrupted_and_resumed_with_other_workers_it_ends_the_same(
    done, plan, tmp_path, monkeypatch, capsys
):
    def stop(*_):
        raise KeyboardInterrupt

    folder = tmp_path / "threads"
    line = ["improve", str(plan), "--evaluations", "128", *SHORT, "--out", str(folder)]
    with monkeypatch.context() as patch:
        patch.setattr(studies, "judge", stop)
        patch.setattr(interrupt, "_again", ["`qdenv improve`"])  # as in a program
        patch.setattr(interrupt, "_way", [""])
        assert run([*line, "--executor", "threads", "--workers", "2"]) == 130
    assert capsys.readouterr().err.endswith(f"stopped; `qdenv resume {folder}` goes on\n")
    assert not (folder / "improve.csv").exists()
    assert run(["resume", str(folder)]) == 0
    for name in ("improve.csv", "a_new_floor.txt", "a_new_floor.toml"):
        assert (folder / name).read_bytes() == (done[1] / name).read_bytes()


def test_better_means_better_at_both_numbers_of_robots():
    good, bad = Difference(5, 1, 9, True), Difference(2, -0.1, 4, False)
    for changes, better in (((good, good), True), ((good, bad), False), ((bad, good), False)):
        assert studies.Judged("racks", None, np.zeros((2, 3)), changes).is_better is better
