"""The book: it builds without a warning, and every public name and command is in its reference."""

import inspect
import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest

import qdenv
from qdenv.cli.main import COMMANDS

ROOT = Path(__file__).parents[1]


def test_the_readme_lists_every_command_in_its_own_words():
    table = (ROOT / "README.md").read_text().partition("<!-- commands -->")[2]
    lines = table.partition("<!-- end of commands -->")[0].strip().splitlines()[2:]
    summaries = {
        name: " ".join(inspect.getdoc(pkgutil.resolve_name(place)).split("\n\n")[0].split())
        for name, place in COMMANDS.items()
    }
    assert lines == [f"| `qdenv {name}` | {text} |" for name, text in summaries.items()]


def test_the_readme_is_short():
    assert len((ROOT / "README.md").read_text().split()) <= 1500


@pytest.mark.slow
def test_the_book_builds_without_warnings_and_has_all_names(tmp_path):
    pytest.importorskip("myst_nb", reason="the book needs the extra docs")
    command = [sys.executable, "-m", "sphinx", "-W", "-q", str(ROOT / "notebooks"), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    python = (tmp_path / "reference" / "python.html").read_text()
    assert [name for name in qdenv.__all__ if name not in python] == []
    commands = (tmp_path / "reference" / "commands.html").read_text()
    assert [name for name in COMMANDS if f"usage: qdenv {name} " not in commands] == []
