"""Every script of experiments/ runs at a toy size, and prints and writes what it promises."""

import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

import qdenv
from experiments import (
    agreement,
    algorithms,
    congestion,
    own_objective,
    polish,
    sphere,
    surrogate,
    which_nca,
    zoo,
)
from experiments.ledger import Run, read_runs
from qdenv.configurations import PRESETS
from qdenv.io.files import write_csv
from qdenv.io.layouts import write_layout
from qdenv.io.records import read_rows, read_table
from qdenv.run.directory import RunDirectory
from qdenv.types import InputError

pytestmark = pytest.mark.slow

FOLDER = Path(__file__).parents[1] / "experiments"


def numbers(text: str) -> list[float]:
    return [float(number) for number in re.findall(r"-?\d+\.?\d*", text)]


@pytest.fixture
def preset(small_run, monkeypatch) -> str:
    """Name a preset with the settings of the small run."""
    monkeypatch.setitem(PRESETS, "small", small_run.config)
    return "small"


def test_every_script_of_its_own_is_tested_here():
    tested = {"which_nca", "algorithms", "sphere", "own_objective"}
    tested |= {"surrogate", "agreement", "congestion", "zoo", "guidance", "polish"}
    # The others are the figures and tables of the paper, and what these are made of.
    scripts = {
        path.stem
        for path in FOLDER.glob("*.py")
        if f'run_program(main, "python -m experiments.{path.stem}")' in path.read_text()
    }
    assert scripts == tested


def test_surrogate_judges_what_a_run_remembers(tmp_path, monkeypatch, capsys):
    import toy

    from qdenv.run.config import choose_algorithm
    from qdenv.run.loop import train
    from qdenv.search.settings import ScreenedConfig
    from qdenv.study import options
    from qdenv.surrogates.settings import SurrogateConfig

    tiny = SurrogateConfig(channels=4, epochs=1, minibatch=8, samples=64)
    search = ScreenedConfig(emitters=2, batch=4, screen=1, refit=1000, surrogate=tiny)
    train(choose_algorithm(toy.CONFIG, search), tmp_path / "run", progress=False)
    monkeypatch.setitem(options._SURROGATES, "small", tiny)
    surrogate.main(tmp_path / "run", counts=(10, 1000), seeds=1, out=tmp_path / "table.csv")
    rows = list(read_rows(tmp_path / "table.csv"))
    # 48 evaluations: a fifth is held out, and whoever asks for more than the others gets these.
    assert {(row["learnt_from"], row["held_out"]) for row in rows} == {("10", "10"), ("38", "10")}
    names = {"learning objective", "objective", "paths", "flowers on top"}
    assert {row["number"] for row in rows} == names
    assert all(float(row["rmse"]) > 0 and float(row["r2"]) < 1 for row in rows)
    with pytest.raises(InputError, match="has no surrogate"):
        train(toy.CONFIG, tmp_path / "plain", progress=False)
        surrogate.main(tmp_path / "plain")


def test_which_nca_prints_the_final_metrics_of_each_automaton(preset, tmp_path, capsys):
    which_nca.main(preset, 1, 6, ("sep",), tmp_path)
    rows = capsys.readouterr().out.splitlines()[2:]
    assert [row[:9] for row in rows] == ["(3, 3, 3)", "(3, 1, 1)"]
    for row, kernels in zip(rows, ("333", "311"), strict=True):
        last = RunDirectory.open(tmp_path / f"small-{kernels}-sep-0").read_metrics()[-1]
        means = numbers(row.replace("(nan)", "")[9:])
        expected = [last.qd_score, last.coverage, last.best_objective]
        np.testing.assert_allclose(means, expected, atol=6e-4)


def test_algorithms_averages_seeds_draws_and_goes_on(preset, tmp_path, capsys):
    names = ("map-elites", "random")
    algorithms.main(preset, 1, 50, ("random",), tmp_path)
    algorithms.main(preset, 2, 100, names, tmp_path)  # goes on with one run, begins three
    said = capsys.readouterr().out
    runs = {
        name: [RunDirectory.open(tmp_path / f"small-{name}-{seed}") for seed in (0, 1)]
        for name in names
    }
    rows = list(read_rows(tmp_path / "algorithms.csv"))
    assert [(row["algorithm"], row["seeds"], row["evaluations"]) for row in rows] == [
        (name, "2", "100") for name in names
    ]
    for row in rows:
        one, other = (run.read_metrics()[-1] for run in runs[row["algorithm"]])
        for metric in ("qd_score", "coverage", "best_objective"):
            pair = np.array([getattr(one, metric), getattr(other, metric)])
            assert float(row[metric]) == pytest.approx(pair.mean(), rel=1e-5)
            # The 97.5 % point of Student's t with one degree of freedom is 12.706.
            margin = 12.7062 * pair.std(ddof=1) / np.sqrt(2)
            assert float(row[f"{metric}_margin"]) == pytest.approx(margin, rel=1e-4, abs=1e-6)
        elites = [run.archive.columns["measures"][:, 1] for run in runs[row["algorithm"]]]
        lowest = np.mean([values.min() for values in elites])
        assert float(row["lowest_entropy"]) == pytest.approx(lowest, rel=1e-5)
        assert f"{row['algorithm']:10}  {float(row['qd_score']):.1f} ± " in said
    assert "6,893 ± 1,292, 0.15" in said and "4 of 4: " in said
    assert imread(tmp_path / "algorithms.png").shape[:2] == (396, 1100)
    before = [path.stat().st_mtime_ns for path in sorted(tmp_path.rglob("*/*"))]
    algorithms.main(preset, 2, 100, names, tmp_path)  # everything is done: runs are only read
    assert [path.stat().st_mtime_ns for path in sorted(tmp_path.rglob("*/*"))] == before
    with pytest.raises(InputError, match="give a larger number"):
        algorithms.main(preset, 2, 50, names, tmp_path)
    with pytest.raises(InputError, match="other settings"):
        algorithms.main("quick", 2, 100, names, rename(tmp_path))


def rename(folder: Path) -> Path:
    """Let the runs of one preset look like those of another."""
    for path in folder.glob("small-*"):
        path.rename(folder / path.name.replace("small", "quick"))
    return folder


def test_sphere_averages_its_seeds(tmp_path, capsys):
    sphere.main(20, 2, 10, ("full",), 2, 6, tmp_path / "sphere.png", tmp_path / "s.csv")
    *seeds, mean = capsys.readouterr().out.splitlines()
    scores = [numbers(line.split(":")[1])[:2] for line in seeds]
    assert len(scores) == 2 and scores[0] != scores[1]
    said = numbers(mean.split("QD-score")[1])
    np.testing.assert_allclose([said[0], said[2]], np.mean(scores, axis=0), atol=0.011)
    assert (tmp_path / "sphere.png").exists()
    saved = [line.split(",") for line in (tmp_path / "s.csv").read_text().splitlines()[1:]]
    assert [row[:3] for row in saved] == [["full", "20", "0"], ["full", "20", "1"]]
    np.testing.assert_allclose([float(row[3]) for row in saved], [s[0] for s in scores], atol=0.01)


def test_own_objective_saves_a_row_per_elite(tmp_path, capsys):
    own_objective.main("cma-mae", 4, 0, tmp_path / "chain")
    said, files = capsys.readouterr().out.splitlines()
    coverage = numbers(said)[-1]
    assert files == f"{tmp_path / 'chain.csv'}, {tmp_path / 'chain.png'}"
    elites = len(list(read_rows(tmp_path / "chain.csv")))
    assert 0 < elites < 3600
    assert coverage == pytest.approx(100 * elites / 3600, abs=0.051)
    assert (tmp_path / "chain.png").exists()


def test_agreement_judges_elites_and_files_and_simulates_nothing_again(
    small_run, tmp_path, capsys, monkeypatch
):
    settings = dict(agents=6, timesteps=20, seeds="2", out=tmp_path)
    monkeypatch.setattr(agreement, "RESAMPLES", 20)
    hall = tmp_path / "hall.json"
    write_layout(hall, small_run.best.layout, small_run.tiles)
    agreement.main(small_run.path, (hall,), 3, **settings)
    runs, first = read_runs(tmp_path / "runs.csv"), capsys.readouterr().out
    assert len(runs) == 4 * 4 * 2 and {run.planner for run in runs} == set(agreement.PLANNERS)
    table = list(read_rows(tmp_path / "agreement.csv"))
    assert [row["layout"].split()[0] for row in table] == ["elite", "elite", "elite", "hall"]
    for row in table:
        own = [
            run.throughput for run in runs if (run.layout, run.planner) == (row["layout"], "low")
        ]
        assert float(row["low"]) == pytest.approx(np.mean(own), rel=1e-5)
    assert (tmp_path / "agreement.png").exists()
    monkeypatch.setattr("experiments.ledger.simulate", None)  # nobody may simulate now
    agreement.main(small_run.path, (hall,), 3, **settings)
    again = capsys.readouterr().out
    assert again[again.index("|") :] == first[first.index("|") :]


def test_agreement_leaves_out_what_congests_under_either_planner(monkeypatch):
    monkeypatch.setattr(agreement, "RESAMPLES", 20)
    paper, low = np.array([1, 2, 3, 4, 5, 0.0]), np.array([2, 1, 3, 5, 4, 9.0])
    means = {"low": low, "high": paper, "plain": paper, "published": paper}
    jams = {name: np.zeros(6, int) for name in means}
    jams["low"][5] = 1
    judged = agreement.Judged({name: one[:, None] for name, one in means.items()}, jams)
    subjects = [agreement.Subject(str(one), None, np.nan, True, None) for one in range(6)]
    found = agreement.compare(subjects, judged)
    # Squared differences of ranks sum to 4: 1 - 6 * 4 / (5 * 24); two of ten pairs swapped.
    assert found["low", "flowing"].layouts == 5
    assert found["low", "flowing"].spearman.value == pytest.approx(0.8)
    assert found["low", "flowing"].kendall.value == pytest.approx(0.6)
    # The sixth, the best for low and the worst for the paper, adds 25 and shifts the other five.
    assert found["low", "all"].spearman.value == pytest.approx(1 - 6 * (4 + 5 + 25) / (6 * 35))
    assert found["high", "flowing"].layouts == 6


def test_congestion_puts_several_files_into_one_table(own_layout, tmp_path, capsys, monkeypatch):
    layout = own_layout("warehouse_human")
    settings = dict(agents="5,8", timesteps=20, seeds="2", planners="low")
    congestion.main((layout,), **settings, out=tmp_path / "a.csv")
    runs = read_runs(tmp_path / "a.csv")
    assert [(run.agents, run.seed) for run in runs] == [(5, 0), (5, 1), (8, 0), (8, 1)]
    jammed = [run._replace(agents=200, throughput=1.5, congested=True) for run in runs[:2]]
    jammed = [run._replace(end_timestep=10 * (2 + run.seed)) for run in jammed]
    good = runs[0]._replace(agents=200, seed=2, throughput=5.0)
    write_csv(tmp_path / "b.csv", Run._fields, [*jammed, good])
    capsys.readouterr()
    monkeypatch.setattr("experiments.ledger.simulate", None)  # nobody may simulate now
    congestion.main((layout,), **settings, out=tmp_path / "a.csv", read=(tmp_path / "b.csv",))
    said = capsys.readouterr().out.splitlines()
    # One of three succeeds: Wilson's interval is 6 to 79 %; runs end at 20 and 30.
    start = "| warehouse_human (warehouse-even) | 200 | 20 | low | 1/3 (6% to 79%) | 5.000 ± nan "
    assert said[2].startswith(start + "| congests |") and said[2].endswith("| 25 (20 to 30) |")
    assert [line.split(" | ")[1] for line in said[3:5]] == ["5", "8"]
    rows = list(read_rows(tmp_path / "a-table.csv"))
    assert [int(row["runs"]) for row in rows] == [3, 2, 2]
    assert float(rows[0]["mean_of_all"]) == pytest.approx(8 / 3)
    assert (tmp_path / "a.png").exists()
    with pytest.raises(InputError, match="no runs"):
        congestion.main(out=tmp_path / "c.csv")


def test_polish_repairs_and_simulates_elites_at_both_levels(small_run, tmp_path, capsys):
    polish.main((small_run.path,), 2, tmp_path / "polish.csv")
    rows = list(read_table(tmp_path / "polish.csv", polish.Row))
    assert [row.polish for row in rows] == ["quick", "full"] * 2
    archive = small_run.archive
    for row in rows[::2]:
        (place,) = np.flatnonzero(archive.columns["index"] == row.cell)
        # What the search did is done again, bit for bit.
        drawn, repaired = (archive.columns[name][place] for name in ("unrepaired", "repaired"))
        assert row.changed == (drawn != repaired).sum() and row.congested == 0
    for quick, full in zip(rows[::2], rows[1::2], strict=True):
        assert quick.bound <= full.bound <= full.changed and full.throughput > 0
    said = capsys.readouterr().out
    assert "| warehouse-even | full | 2 |" in said


def test_zoo_chooses_measures_and_writes_the_same_files_again(small_run, tmp_path, monkeypatch):
    rules = zoo.RULES["warehouse-even"]
    best_of_two = rules[0]._replace(tried=2, apart=0)
    monkeypatch.setattr(zoo, "RULES", {"warehouse-even": (best_of_two, rules[1])})
    how = zoo.Measuring(sizes=("9x10", "13x12"), timesteps=20, seeds="2", trial_timesteps=10)
    zoo.main(small_run.path, how, tmp_path / "runs.csv", tmp_path / "zoo")
    folder, archive = tmp_path / "zoo" / "warehouse-even", small_run.archive
    content = json.loads((folder / "generators.json").read_text())
    assert content["origin"]["algorithm"] == "cma-mae"
    assert content["origin"]["evaluations"] == small_run.read_metrics()[-1].evaluations
    best, regular = content["generators"]
    assert (best["name"], regular["name"]) == ("best", "regular")
    runs = read_runs(tmp_path / "runs.csv")
    # The trial of each candidate at the last size; the best moves most.
    trials = {run.layout: run.throughput for run in runs if run.timesteps == 10}
    named = ",".join(map(str, best["cell"])) + " 13x12"
    tried = [f"{','.join(map(str, cell))} 13x12" for cell in best_two(small_run)]
    assert trials[named] == max(trials[name] for name in tried)
    for one in content["generators"]:
        kept = RunDirectory(folder).archive.elite(tuple(one["cell"]))
        np.testing.assert_array_equal(kept.solution, archive.elite(tuple(one["cell"])).solution)
        small, large = one["sizes"]
        assert (small["numbers"], large["rows"]) == ({"shelves": 6}, 13)
        own = [
            run.throughput
            for run in runs
            if run.layout == f"{','.join(map(str, one['cell']))} 13x12"
            and (run.timesteps, run.planner) == (20, "high")
        ]
        high, published = large["driven"]
        assert (high["runs"], published["runs"], published["planner"]) == (2, 1, "published")
        assert high["mean"] == pytest.approx(np.mean(own), rel=1e-5)
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    monkeypatch.setattr("experiments.ledger.simulate", None)  # nobody may simulate now
    zoo.main(small_run.path, how, tmp_path / "runs.csv", tmp_path / "zoo")
    with pytest.raises(InputError, match="another --out"):
        zoo.main(folder, how, tmp_path / "runs.csv", tmp_path / "zoo")
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    with pytest.raises(InputError, match="too few elites"):
        zoo.choose(zoo.Workshop([small_run], how, tmp_path / "runs.csv"), rules * 3)


def best_two(run: RunDirectory) -> list[tuple[int, ...]]:
    """List the two cells of the best elites that flowed."""
    columns = run.archive.columns
    flowed = np.flatnonzero(~columns["congested"].any(axis=1))
    good = flowed[np.argsort(-columns["objective"][flowed], kind="stable")]
    return [tuple(map(int, run.archive.cells[row])) for row in good[:2]]


def test_elites_of_further_runs_count_like_the_runs_own(small_run, tmp_path):
    cell = ",".join(map(str, small_run.best.cell))
    config = dataclasses.replace(small_run.config, start=f"{small_run.path}@{cell}", seed=1)
    further = qdenv.train(config, tmp_path / "further", progress=False)
    workshop = zoo.Workshop([small_run, further], zoo.Measuring(), tmp_path / "runs.csv")
    found, runs = workshop.archive, (small_run.archive, further.archive)
    taken = [
        dict(zip(map(tuple, one.cells), one.columns["objective"], strict=True)) for one in runs
    ]
    expected = {
        cell: max(one[cell] for one in taken if cell in one) for cell in {*taken[0], *taken[1]}
    }
    assert len(expected) > len(runs[0]) and len(found) == len(expected)
    for cell, objective in expected.items():
        assert found.elite(cell).objective == objective
    origin = zoo.origin_of(workshop, "warehouse-even")
    assert origin.further == further.read_metrics()[-1].evaluations
    other = dataclasses.replace(config, evaluation=dataclasses.replace(config.evaluation, alpha=1))
    strange = qdenv.train(other, tmp_path / "strange", progress=False)
    with pytest.raises(InputError, match="its objectives mean something else"):
        zoo.Workshop([small_run, strange], zoo.Measuring(), tmp_path / "runs.csv")


def test_one_elite_is_tried_in_each_square_of_the_archive():
    cells = [(9, 9), (8, 15), (0, 7), (7, 0), (8, 16)]
    assert zoo.spread(cells, 8) == [(9, 9), (0, 7), (8, 16)]
    assert zoo.spread(cells, 0) == cells


def test_zoos_rules_narrow_down_before_they_order():
    numbers = {
        "objective": np.array([5.0, 4.0, 3.0, 2.0, 1.0]),
        "environment entropy": np.array([0.5, 0.1, 0.4, 0.1, 0.0]),
    }
    regular = zoo.Rule("regular", "", "-environment entropy")
    # The better half of five are two; of equal ones the first stays first.
    assert zoo.in_order(regular, numbers, np.arange(5)).tolist() == [1, 0]
    twice = zoo.Rule("x", "", "-environment entropy", (("objective", 0.8),))
    assert zoo.in_order(twice, numbers, np.arange(5)).tolist() == [1, 3, 2, 0]
    assert zoo.in_order(twice, numbers, np.array([4])).tolist() == [4]
