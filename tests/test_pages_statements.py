"""Figures of the README, the results page, the notes and guides, computed from what is saved."""

import json
import math
import re

import numpy as np
import pytest
from conftest import STUDY_DATA
from test_experiments_statements import NOTES, PAGE, RESULTS, page, rows

from experiments.figure_18 import PEAKS
from experiments.pieces import Folders
from experiments.published import AGENTS, FLEETS, TRAFFIC
from experiments.zoo_rules import RULES
from qdenv.agent.settings import TrainConfig
from qdenv.agent.train import _exam
from qdenv.run.directory import RunDirectory
from qdenv.search.strategies.cma_es import refresh_gap
from qdenv.shipped import named
from qdenv.simulation.maze.policy import load_weights
from qdenv.stats import difference

WORDS = ("no", "one", "two", "three", "four", "five")
FRONT = page("README.md")


def flows(maker: str, domain: str, planner: str) -> list[bool]:
    """List which runs on a layout of 101 x 102 with the paper's agents flow, by seed."""
    which = {"layout": f"{domain}-{maker}-101x102", "planner": planner}
    runs = rows(f"traffic/makers-{domain}.csv", **which, agents=str(AGENTS[domain][101, 102]))
    return [row["congested"] == "False" for row in sorted(runs, key=lambda row: int(row["seed"]))]


def on_papers_layouts(*agents: int) -> list[dict[str, str]]:
    """List what priority-based search, by either rule, makes of the paper's NCA layouts."""
    own = [row for row in rows("congestion.csv", timesteps="1000") if int(row["agents"]) in agents]
    own = [row for row in own if row["layout"].endswith("_nca_a5")]
    return [row for row in own if row["planner"] in ("published", "plain")]


def test_the_pages_state_how_often_the_zoos_best_flow_under_the_papers_planner():
    succeed, paper = [], []
    for domain in ("warehouse-uneven", "warehouse-even", "manufacturing"):
        runs = flows("zoo", domain, "published")
        succeed.append(f"{sum(runs)}/{len(runs)}")
        paper.append(f"{100 * TRAFFIC[domain, 'nca', AGENTS[domain][101, 102]].success:.0f}")
    runs = "{}, {} and {} runs succeed".format(*succeed)
    chosen = "each generator was chosen by the first of its 50"
    assert f"{runs}; {chosen} (paper: {', '.join(paper)} %)" in FRONT


def test_the_page_states_where_the_layout_designed_by_hand_moves_more():
    hand, ours = (PEAKS["manufacturing", (33, 36), maker] for maker in ("human", "nca"))
    theirs, own = hand.read(Folders()), ours.read(Folders())
    peaks = [f"{one.mean_of_all:.2f} with {one.agents}" for one in (theirs, own)]
    more = difference(theirs.sample_of_all, own.sample_of_all)
    percent = f"{more.percent:.0f} % ({more.low:.0f} to {more.high:.0f})"
    assert "{} robots against {}, {}".format(*peaks, percent) in PAGE
    second = sorted(ours.outcomes(Folders()), key=lambda one: one.mean_of_all)[-2]
    assert not difference(second.sample_of_all, own.sample_of_all).significant
    same = f"moves the same with {second.agents} as with {own.agents}"
    assert f"{same}, the one by hand most with {theirs.agents})" in PAGE


def test_the_notes_state_when_the_hand_made_warehouse_jams():
    fleets = rows("congestion.csv", layout="warehouse_human", timesteps="1000")
    found = {(row["agents"], row["planner"]): row for row in fleets}
    for agents in ("150", "200", "250", "300"):
        row = found[agents, "published"]
        cells = ["{:.2f}, {successes} of {runs} runs flow".format(float(row["throughput"]), **row)]
        if agents != "150":
            assert row["successes"] == "0"
            span = ", at {:.0f} to {:.0f}".format(float(row["jam_least"]), float(row["jam_most"]))
            cells = [f"all {row['runs']} congest{span * (agents == '200')}"]
        others = (found[agents, planner] for planner in ("plain", "high", "low"))
        cells += [f"{float(other['throughput']):.2f}" for other in others]
        assert f"| {agents}{' robots' * (agents == '150')} | {' | '.join(cells)} |" in NOTES
    own = {row["planner"]: float(row["cpu_seconds"]) for row in fleets if row["agents"] == "200"}
    cells = (
        "200 robots | {published:.2g} until they congest | {plain:.2g} | {high:.2g} | {low:.2g} |"
    )
    assert cells.format(**own) in NOTES


def test_the_notes_state_what_pbs_makes_of_published_layouts():
    spent = [float(row["cpu_seconds"]) for row in on_papers_layouts(200)]
    assert f"takes `pbs` {min(spent):.1f} to {max(spent):.1f} CPU seconds" in NOTES
    (large,) = rows("congestion.csv", layout="warehouse_even_nca_a5_eval")
    spent = f"jam ({float(large['cpu_seconds']):.0f} CPU seconds a run on average)"
    paper = 100 * TRAFFIC["warehouse-even", "nca", int(large["agents"])].success
    reach = "{successes} of {runs} runs reach the end and the others".format(**large)
    assert f"{reach} {spent}; in the paper {paper:.0f} % do not jam" in NOTES
    (edge,) = rows("congestion.csv", layout="warehouse_even_dsage", timesteps="5000")
    jams, moved = int(edge["runs"]) - int(edge["successes"]), f"{float(edge['throughput']):.2f}"
    jams = f"{jams} of {edge['runs']} runs of T = {edge['timesteps']} congest"
    assert f"{jams}, and the others move {moved} as in the paper" in NOTES
    assert moved == f"{TRAFFIC['warehouse-even', 'dsage', 200].throughput:.2f}"


def test_the_notes_compare_pbs_with_the_published_program():
    path = STUDY_DATA / "rhcr_baseline.json"
    if not path.exists():
        pytest.skip("no recorded runs of the C++ here (QDENV_STUDY_DATA names their folder)")
    spent, apart, records = [], [], json.loads(path.read_text())["records"]
    for row in on_papers_layouts(150, 200, 250):
        key = (f"{row['layout']}.json", int(row["agents"]), 1000)
        theirs = [one for one in records if (one["layout"], one["n_agents"], one["T"]) == key]
        mean = np.mean([one["throughput"] for one in theirs])
        apart.append(abs(100 * (float(row["throughput"]) / mean - 1)))
        spent += [one["cpu_s"] for one in theirs if key[1] == 200]
    assert f"and the C++ {min(spent):.0f} to {max(spent):.0f};" in NOTES
    assert f"within {max(apart):.1f} % of the C++ at 150 to 250 robots" in NOTES


def test_the_page_of_improvements_states_gains_where_shelves_are_alike_and_jams():
    text, found = page("notebooks/how_to/improve.md"), rows("improve.csv", section="rows")
    assert len(found) == 24  # four halls, three seeds, two numbers of robots
    for row, more in zip(found[::2], found[1::2], strict=True):
        gains = [[float(one[name]) for name in ("percent", "low", "high")] for one in (row, more)]
        alike = f"+{float(row['by_shelf']):.1f} %" if row["by_shelf"] else "not saved"
        cells = [row["seed"], row["racks_moved"]]
        cells += ["+{:.1f} % ({:.1f} to {:.1f})".format(*gain) for gain in gains]
        assert f"| {' | '.join([*cells, alike])} |" in text
    moved = [f"{float(row['throughput']):.2f}" for row in rows("improve_pbs.csv")]
    for hers, ours in zip(moved[::2], moved[1::2], strict=True):
        assert f"* {ours} instead of {hers} " in text
    gains = [float(row["percent"]) for row in found[::2]]
    assert f"[{min(gains):.0f} to {max(gains):.0f} % more tasks with all shelves moved](" in FRONT
    better = {}
    for section in ("lanes", "racks", "rows", "floor"):
        saved = rows("improve.csv", section=section)[::2]
        assert len(saved) == 12
        gains = [float(row["percent"]) for row in saved if row["better"] == "True"]
        better[section] = f"{min(gains):.1f} to {max(gains):.1f} %" if gains else ""
        assert len(gains) == {"lanes": 0, "racks": 4}.get(section, 12)
    assert f"twelve searches, and `racks` {better['racks']} more tasks in four of twelve**" in text
    assert f"in all: {better['rows']} and {better['floor']} more tasks." in text
    flow = [float(row["success_rate"]) for row in rows("improve_pbs.csv", runs="6")]
    words = [WORDS[round(6 * (1 - share))] for share in flow]
    assert words[:2] == ["no", "no"] and "in the hall of 30 x 40, where nothing jams" in text
    assert f"where {words[3]} run of six jams instead of {words[2]}" in text
    assert f"where {words[5]} run jams instead of {words[4]}" in text


@pytest.mark.slow
def test_the_agents_page_states_its_training():
    folder = "qdenv/simulation/maze"
    text = page(f"{folder}/README.md")
    curve = (RESULTS.parents[1] / folder / "curve.jsonl").read_text()
    *_, last = log = [json.loads(line) for line in curve.splitlines()]
    made = [row for row in log if row["update"] % 120 == 0 or row is last]
    cells = "| {:.1f} | {cpu_seconds:.0f} | {success_longest:.2f} | {exam_60:.2f} | {exam_90:.2f} |"
    cells = " ".join(cells.format(row["steps"] / 1e6, **row) for row in made)
    assert f"exam 90 | | --- | --- | --- | --- | --- | {cells} ## Measured" in text
    assert f"took {last['steps'] / 1e6:.1f} million steps, {last['cpu_seconds']:.0f} CPU" in text
    assert f"are the first {last['steps'] / 60e4:.0f} %" in text  # of 60 million
    assert f"agent is the last one, of update {last['update']}: in the exam it does better" in text
    exams = {name: last[name] for name in ("exam_60", "exam_90")}
    assert sum(exams.values()) > sum(last[f"mean_{name}"] for name in exams)
    # Another machine's last bits may change a few of the 256 episodes.
    assert _exam(TrainConfig())(load_weights()) == pytest.approx(exams, abs=0.02)


def test_the_zoo_says_of_its_generators_what_their_rules_say():
    for domain, rules in RULES.items():
        made = named(domain).collection.generators
        assert [(one.name, one.about) for one in made] == [rule[:2] for rule in rules]
    even, uneven = (RULES[domain][0].tried for domain in FLEETS[:2])
    assert f"among up to {even} elites ({uneven} of `warehouse-uneven`" in PAGE
    made = {one.name: one.sizes[0].driven[0] for one in named("maze-walls").collection.generators}
    shares = {name: round(one.success * one.runs) for name, one in made.items()}
    hard = f"`hard` in {shares.pop('hard')} of 100 runs, of each other one in at least "
    assert f"{hard}{min(shares.values())} (`qdenv zoo" in page("notebooks/06_mazes.ipynb")


def test_the_page_states_the_searches_behind_both_zoos():
    for domain in FLEETS:
        made = named(domain).collection
        assert f"by {made.origin.evaluations:,} evaluations from the first zoo's best" in PAGE
        assert f"and by {made.origin.further:,} around other elites" in PAGE
    for domain in FLEETS[:2]:
        origin = json.loads((RESULTS / "zoo" / f"{domain}.json").read_text())["origin"]
        stated = "'s from {evaluations:,}( evaluations)? of seed {seed}"
        stated += "( [(]an earlier search than Table 4's[)])? and {further:,} more"
        assert re.search(f"`{domain}`{stated.format(**origin)}", PAGE)


def test_the_notes_state_entropies_memory_and_what_another_repair_costs():
    (dsage,) = rows("algorithms.csv", algorithm="dsage")
    assert f"elites is {float(dsage['lowest_entropy']):.2f}, mean of the five seeds" in NOTES
    run = RunDirectory.open(RESULTS / "runs" / "maze-walls")
    cells = math.prod(axis.cells for axis in run.archive.schema.measures)
    weights = run.archive.columns["solution"].shape[1]
    filled = f"If all {cells:,} cells of `maze-walls` were filled, with {weights:,} float32"
    assert f"{filled} parameters each, they would take {4 * cells * weights / 1e9:.1f} GB" in NOTES
    assert f"or {math.ceil(refresh_gap(weights, run.config.algorithm.batch)):,} (3, 3, 3)" in NOTES
    less = []
    for domain in FLEETS:
        both = [rows("polish.csv", domain=domain, polish=one) for one in ("quick", "full")]
        quick, full = (np.mean([float(row["throughput"]) for row in own]) for own in both)
        less.append(100 * (1 - full / quick))
    assert f"moved {min(less):.1f} to {max(less):.1f} % less on average" in NOTES
