"""Where results go: named, said, never over one another; facts that explain themselves."""

import json
import math
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest
from small_warehouse import ROWS

from qdenv.cli.main import run
from qdenv.io.files import tidy
from qdenv.ops.output import AUTO, PICTURES, Place, format_table, place
from qdenv.types import InputError


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_name_nobody_gave_never_replaces_a_file(folder):
    names = []
    for _ in range(3):
        target = place(AUTO, "plan.json")
        target.path.touch()
        names.append(str(target))
    assert names == ["plan.json", "plan-2.json", "plan-3.json"]


def test_a_file_that_is_named_may_be_replaced_and_that_is_said(folder):
    assert str(place(Path("new.json"), "plan.json")) == "new.json"
    (folder / "new.json").touch()
    assert str(place(Path("new.json"), "plan.json")) == "new.json (replaced)"


def test_a_picture_lies_beside_its_data(folder):
    assert place(Path("a/table.csv"), "x.csv").beside(".png") == Place(Path("a/table.png"), False)
    (folder / "table_frames.png").touch()
    beside = place(Path("table.csv"), "x.csv").beside("_frames.png")
    assert beside == Place(Path("table_frames.png"), True)


@pytest.mark.parametrize(
    ("out", "endings", "said"),
    [
        ("plan.png", (), "a picture's name: name the data plan.json"),
        ("plan.SVG", (), "a picture's name"),
        ("plan.json", PICTURES, r"ends in .png or .svg or .pdf"),
        ("folder", (), "that is a folder: name a file in it, like folder/plan.json"),
        ("read.json", (), "that is what is read"),
        ("link.json", (), "that is what is read"),
    ],
)
def test_names_that_would_lose_something_are_refused(folder, out, endings, said):
    (folder / "folder").mkdir()
    (folder / "read.json").touch()
    (folder / "link.json").symlink_to("read.json")
    with pytest.raises(InputError, match=said):
        place(Path(out), "plan.json", endings, [Path("read.json")])


def test_facts_are_plain_json_with_six_digits_and_no_dust():
    value = {
        "a": np.float32(3.2980000972747803),
        "b": 0.9999999999999999,
        "c": [math.nan, np.int64(7), True, None, "x"],
        "d": np.array([[1.5, 2.0]]),
        "e": Path("p"),
        "f": np.bool_(False),
    }
    assert tidy(value) == {
        "a": 3.298,
        "b": 1.0,
        "c": [None, 7, True, None, "x"],
        "d": [[1.5, 2.0]],
        "e": "p",
        "f": False,
    }


def test_facts_name_the_command_its_settings_and_the_version(folder, capsys):
    Path("p.txt").write_text("\n".join(ROWS))
    assert run(["check", "p.txt", "--json", "f.json"]) == 0
    assert json.loads(Path("f.json").read_text()) == {
        "valid": True,
        "rules": True,
        "broken": [],
        "command": "check",
        "qdenv": metadata.version("qdenv"),
        "settings": {"layout": "p.txt", "domain": "warehouse-even", "keep": None, "numbers": {}},
    }
    # A dash is standard output, where nothing else is written then.
    capsys.readouterr()
    assert run(["check", "p.txt", "--json", "-"]) == 0
    printed = capsys.readouterr()
    assert "obeys every rule" in printed.err
    assert json.loads(printed.out)["valid"] is True


def test_columns_of_a_table_are_as_wide_as_their_widest_cell():
    assert format_table([("a", "bb"), (100, "c"), ("x", "")]) == ["a    bb", "100  c", "x"]
