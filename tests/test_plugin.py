"""A package of somebody else's: its domain, planner and algorithm in the installed command."""

import csv
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from qdenv.run.directory import RunDirectory

pytestmark = pytest.mark.slow

TESTS = Path(__file__).parent
PLUGIN = TESTS / "plugin"
PAGE = TESTS.parent / "notebooks" / "how_to" / "extend.md"


@pytest.fixture(scope="module")
def command(tmp_path_factory):
    """Install the plug-in into a folder of its own, and run programs beside it."""
    place = tmp_path_factory.mktemp("site")
    pip = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-index"]
    source = tmp_path_factory.mktemp("source") / "plugin"  # builds leave files behind
    source.mkdir()
    for path in PLUGIN.glob("*.*"):
        (source / path.name).write_bytes(path.read_bytes())
    subprocess.run([*pip, "--no-build-isolation", "--target", str(place), str(source)], check=True)
    paths = os.pathsep.join([str(place), *filter(None, [os.environ.get("PYTHONPATH")])])

    def run(*arguments: object) -> None:
        environment = os.environ | {"PYTHONPATH": paths}
        done = subprocess.run(
            [*map(str, arguments)], env=environment, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr

    return run


def test_the_book_shows_this_very_package():
    section = PAGE.read_text()
    (toml,) = re.findall(r"```toml\n(.*?)```", section, re.DOTALL)
    parts = re.findall(r"```python\n(.*?)```", section, re.DOTALL)[:3]
    assert toml == (PLUGIN / "pyproject.toml").read_text()
    assert "\n\n".join(parts) == (PLUGIN / "orchard.py").read_text()


def test_commands_know_the_domain_the_planner_and_the_algorithm(command, tmp_path):
    """`RunDirectory` is not asked for the configuration here: this process lacks the plug-in."""
    path = tmp_path / "run"
    small = "--rows 8 --cols 9 --trees 9 --agents 3 --timesteps 40 --steps 4 --hidden 4 "
    small += "--simulations 1 --evaluations 12 --batch 6 --sigma 0.5 --no-progress"
    chosen = ["--domain", "orchard", "--planner", "turns", "--algorithm", "mutate-best"]
    chosen += ["--planner.noise", "2.5"]
    program = Path(sys.executable).with_name("qdenv")
    command(program, "train", "quick", *chosen, *small.split(), "--run-dir", path)
    config = json.loads((path / "config.json").read_text())
    domain = config["evaluation"]["domain"]
    assert (domain["name"], domain["trees"]) == ("orchard", 9)
    assert domain["fleet"]["planner"] == {"name": "turns", "noise": 2.5}
    assert config["algorithm"] == {"name": "mutate-best", "batch": 6, "sigma": 0.5}
    archive = RunDirectory.open(path).archive.columns
    assert len(archive["index"]) >= 1
    assert ((archive["repaired"] == 1).sum(axis=(1, 2)) == 9).all()

    out, series, facts = (tmp_path / name for name in ("big.json", "series", "facts.json"))
    tasks = ["--domain", "orchard", "--agents", 3, "--timesteps", 100, "--seeds", 2]
    others = [
        ["resume", path, "--evaluations", 24, "--no-progress"],
        ["generate", path, "--rows", 10, "--cols", 12, "--trees", 15, "--out", out],
        ["check", out, "--domain", "orchard", "--trees", 15],
        ["series", path, "--sizes", "8x9", "9x11", "--trees", "9", "12", "--out", series],
        ["simulate", out, *tasks, "--planner", "turns", "--json", facts],
    ]
    others = [[*map(str, one)] for one in others]
    call = "from qdenv.cli.main import run"
    command(sys.executable, "-c", f"{call}\nfor one in {others}:\n    assert run(one) == 0, one")
    assert RunDirectory.open(path).read_metrics()[-1].evaluations == 24
    layout = json.loads(out.read_text())["layout"]
    assert (len(layout), len(layout[0]), "".join(layout).count("T")) == (10, 12, 15)
    table = list(csv.DictReader((series / "series.csv").read_text().splitlines()))
    assert [row["trees"] for row in table] == ["9", "12"]
    found = json.loads(facts.read_text())
    assert (found["domain"], found["valid"]) == ("orchard", True)
    assert found["planner"] == "turns, noise 1.5"
    assert np.mean([run["throughput"] for run in found["runs"]]) > 0
