"""The command line: its promised forms, its files, one line and exit code 2 for every mistake."""

import importlib
import inspect
import json
import os
import pkgutil
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import read_layout
from small_warehouse import ROWS as GOOD
from small_warehouse import TILES

from qdenv.cli import main as cli
from qdenv.cli.help import example_of
from qdenv.cli.main import run
from qdenv.configurations import PRESETS
from qdenv.grid import parse
from qdenv.io.layouts import write_layout


def write(path, rows=GOOD):
    write_layout(path, parse(rows, TILES), TILES)
    return str(path)


@pytest.fixture
def layout(tmp_path):
    return write(tmp_path / "layout.json")


@pytest.mark.parametrize("command", cli.COMMANDS)
def test_help_says_of_a_command_the_first_line_of_its_docstring(command):
    module, _, name = cli.COMMANDS[command].partition(":")
    own = inspect.getdoc(getattr(importlib.import_module(module), name))
    assert own and cli.summary_of(command) == own.splitlines()[0]


# Run a command line, then name what it imported of the packages that take long.
LOADED = """
import contextlib, sys
from qdenv.cli.main import run
with contextlib.suppress(SystemExit):
    run({arguments!r})
print("loaded:", *({{"jax", "numba", "numpy", "matplotlib", "qdax", "scipy"}} & sys.modules.keys()))
"""


@pytest.mark.parametrize(
    ("arguments", "said", "loaded"),
    [
        (["--help"], "evaluate-agent", set()),
        (["--version"], "0.", set()),
        (["nothing"], "unknown command", set()),
        (["presets"], "maze-quick", {"numpy"}),
        (["simulate", "--help"], "number of agents", {"numpy"}),
        (["train", "--help-all"], "--emitters", {"numpy"}),
        (["train", "quick", "--shelves", "1000"], "at least 1000", {"numpy"}),
        (["check", "nowhere.json"], "cannot be read", {"numpy"}),
        (["simulate", "nowhere.json"], "cannot be read", {"numpy"}),
        (["replay", "nowhere.json"], "cannot be read", {"numpy"}),
        (["repair", "nowhere.json"], "cannot be read", {"numpy"}),
        (["render", "nowhere.json"], "cannot be read", {"numpy"}),
        (["layout", "symbols"], "workstation", {"numpy"}),
        (["layout", "human", "--rows", "1001", "--cols", "9"], "more than 1000", {"numpy"}),
        (["sweep", "nowhere.json"], "cannot be read", {"numpy"}),
        (["compare", "nowhere.json"], "cannot be read", {"numpy"}),
        (["resume", "nowhere"], "no run here", {"numpy"}),
        (["generate", "nowhere"], "no run here", {"numpy"}),
        (["evaluate-agent", "nowhere.json"], "cannot be read", {"numpy"}),
        (["train-agent", "--steps", "0"], "steps must be at least 1", {"numpy"}),
    ],
)
def test_a_command_line_imports_no_more_than_it_needs(arguments, said, loaded):
    script = LOADED.format(arguments=arguments)
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    answer, _, names = done.stdout.rpartition("loaded:")
    assert said in answer + done.stderr
    assert set(names.split()) <= loaded


def test_the_package_runs_as_a_module():
    command = [sys.executable, "-m", "qdenv", "--version"]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert said == importlib.metadata.version("qdenv") + "\n"


@pytest.mark.parametrize("arguments", [["train", "--help"], ["--help"], ["presets"]])
def test_a_reader_who_has_read_enough_is_no_error(arguments):
    command = [sys.executable, "-m", "qdenv", *arguments]
    reader, writer = os.pipe()
    os.close(reader)  # as `| head` does
    try:
        done = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, text=True)
    finally:
        os.close(writer)
    assert (done.returncode, done.stderr) == (0, "")


def test_check_names_every_broken_rule_and_a_cell(layout, tmp_path, capsys):
    assert run(["check", layout]) == 0
    assert run(["check", layout, "--shelves", "6"]) == 0
    assert run(["check", layout, "--shelves", "7"]) == 1
    assert "7" in capsys.readouterr().out
    rows = [row.replace("w", ".") for row in GOOD]
    rows[5] = ".....e....."
    assert run(["check", write(tmp_path / "broken.json", rows)]) == 1
    said = capsys.readouterr().out.splitlines()
    assert len(said) >= 3  # no workstations, an endpoint without a shelf, the summary
    assert sum("row" in line and "column" in line for line in said) >= 2


@pytest.mark.slow
def test_repair_writes_what_it_promises(layout, tmp_path, capsys):
    out, facts = tmp_path / "r.json", tmp_path / "f.json"
    command = ["repair", layout, "--domain", "warehouse-even", "--shelves", "8", "--seed", "0"]
    picture = tmp_path / "d.png"
    assert run([*command, "--out", str(out), "--json", str(facts), "--diff", str(picture)]) == 0
    content = json.loads(facts.read_text())
    assert {"status", "hamming", "lower_bound", "cpu_seconds", "valid"} <= content.keys()
    assert content["valid"] and content["lower_bound"] <= content["hamming"]
    before, after = read_layout(layout, TILES), read_layout(out, TILES)
    assert (before != after).sum() == content["hamming"]
    assert run(["check", str(out), "--shelves", "8"]) == 0
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_simulate_writes_what_it_promises(layout, tmp_path):
    facts = tmp_path / "f.json"
    command = ["simulate", layout, "--domain", "warehouse-even", "--agents", "4"]
    command += ["--timesteps", "40", "--seeds", "2", "--effort", "low", "--json", str(facts)]
    assert run(command) == 0
    content = json.loads(facts.read_text())
    assert content.keys() >= {
        "layout", "domain", "planner", "agents", "timesteps", "runs", "mean_throughput",
        "mean_of_all", "success_rate", "cpu_seconds_per_run", "compile_seconds", "valid",
    }  # fmt: skip
    assert content["valid"] is True and content["layout"] == layout
    assert [one["seed"] for one in content["runs"]] == [0, 1]
    keys = {*("seed", "throughput", "congested", "congested_at", "end_timestep", "finished_tasks")}
    for one in content["runs"]:
        assert one.keys() == keys
        assert one["throughput"] == pytest.approx(one["finished_tasks"] / 40)
    assert np.mean([one["throughput"] for one in content["runs"]]) > 0.2


@pytest.mark.parametrize(
    ("rows", "agents", "reason"),
    [
        ([row.replace("w", ".") for row in GOOD], 4, "no workstation"),
        ([row.replace("e", ".") for row in GOOD], 4, "no endpoint"),
        (GOOD, 500, "500 agents need as many free cells"),
        (["w@.e", "w@.@", ".@.e"], 2, "cut off"),
    ],
)
def test_simulate_refuses_what_no_fleet_can_drive_on(rows, agents, reason, tmp_path, capsys):
    path = write(tmp_path / "bad.json", rows)
    assert run(["simulate", path, "--agents", str(agents), "--timesteps", "10"]) == 2
    said = capsys.readouterr().err
    assert reason in said and said.count("\n") == 1 and "Traceback" not in said


def test_presets_hold_the_papers_numbers(capsys):
    assert run(["presets"]) == 0
    said = capsys.readouterr().out
    assert all(name in said for name in PRESETS)
    assert (
        "manufacturing, 101 x 102: 1800 agents, 5000 timesteps, 200 steps of growth\n"
        "  maze-walls, 66 x 66: 8712 timesteps, 200 steps of growth"
    ) in said
    even = PRESETS["warehouse-even"]
    numbers, warehouse = even.evaluation, even.evaluation.domain
    assert (warehouse.rows, warehouse.cols, warehouse.shelves) == (33, 36, 240)
    assert (warehouse.fleet.agents, warehouse.fleet.timesteps) == (200, 1000)
    assert (numbers.simulations, numbers.generator.steps) == (5, 50)
    assert (even.algorithm.emitters, even.algorithm.batch, even.evaluations) == (5, 10, 10_000)
    assert (even.algorithm.sigma0, even.algorithm.learning_rate) == (0.2, 0.01)
    assert [PRESETS[f"warehouse-uneven{a}"].evaluation.alpha for a in ("", "-a1", "-a0")] == [
        5,
        1,
        0,
    ]


@pytest.mark.slow
def test_train_generate_resume_end_to_end(tmp_path, capsys):
    path = tmp_path / "run"
    small = ["--rows", "9", "--cols", "10", "--shelves", "6", "--agents", "6", "--timesteps", "20"]
    small += ["--steps", "6", "--hidden", "4", "--emitters", "2", "--batch", "3", "--no-progress"]
    small += ["--evaluations", "12", "--seed", "1", "--simulations", "1"]
    assert run(["train", "quick", "--run-dir", str(path), *small]) == 0
    names = ["config.json", "manifest.json", "metrics.csv", "archive.npz", "best_layout.json"]
    assert all((path / name).exists() for name in [*names, "archive.png", "best_layout.png"])
    assert json.loads((path / "config.json").read_text())["evaluation"]["generator"]["hidden"] == 4
    assert run(["check", str(path / "best_layout.json"), "--shelves", "6"]) == 0

    out = tmp_path / "grown.json"
    command = ["generate", str(path), "--out", str(out)]
    assert run([*command, "--elite", "best"]) == 0
    # Grown again at the trained size, the elite is the layout that was evaluated.
    again, best = read_layout(out, TILES), read_layout(path / "best_layout.json", TILES)
    np.testing.assert_array_equal(again, best)
    assert run([*command, "--elite", "best", "--rows", "14", "--cols", "15", "--steps", "9"]) == 0
    assert read_layout(out, TILES).shape == (14, 15)
    assert run(["check", str(out)]) == 0
    assert run([*command, "--elite", "99,99"]) == 2
    assert run([*command, "--elite", "nonsense"]) == 2
    assert run(["train", "--run-dir", str(path), *small]) == 2

    capsys.readouterr()
    assert run(["resume", str(path), "--evaluations", "18", "--no-progress"]) == 0
    assert "after 18 evaluations" in capsys.readouterr().out


@pytest.mark.parametrize("name", cli.COMMANDS)
def test_help_is_one_screen_with_an_example_that_parses(name, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    shown = []
    for option in ("--help", "--help-all"):
        with pytest.raises(SystemExit):
            cli.run([*name.split(), option])
        shown.append(capsys.readouterr().out)
    short, long = (set(re.findall(r"^  (--[a-z-]+)", text, re.M)) for text in shown)
    assert len(shown[0].splitlines()) <= 50 and max(map(len, shown[0].splitlines())) <= 80
    assert short - {"--help-all"} <= long and ("--help-all" in short) == (short != long)
    entries = re.split(r"\n(?=  \S)", shown[1])[1:]
    assert [one for one in entries if one[2] == "-" and "  " not in one.strip()] == []
    operation = pkgutil.resolve_name(cli.COMMANDS[name])
    example = example_of(inspect.getdoc(operation))
    assert f"  $ {example}\n" in shown[0] and example.startswith(f"qdenv {name}")
    assert cli.parse_command(*cli.split_name(shlex.split(example)[1:]))[0] is operation


def test_help_lists_every_command_once_under_its_group(capsys):
    assert cli.run(["--help"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line for line in lines[1:] if line[:1].isalpha()] == list(cli.GROUPS)
    named = [line[2:18].strip() for line in lines if line[:2] == "  " and line[2] != " "]
    assert named == list(cli.COMMANDS) and len(set(named)) == sum(map(len, cli.GROUPS.values()))


def test_a_plan_behind_a_sign_of_equality_has_the_options_of_its_domain(folder):
    Path("plan.txt").write_text("\n".join(GOOD))
    for plan in (["--plan", "plan.txt"], ["--plan=plan.txt"]):
        words = ["zoo:manufacturing/best", *plan, "--shelves", "3"]
        _, stated = cli.parse_command("generate", words)
        assert stated.arguments.arguments["numbers"] == {"shelves": 3}
