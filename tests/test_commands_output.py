"""Where results go: named, said, never over one another; facts that explain themselves."""

import json
import math
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest

from qdenv.commands.output import PICTURES, Place, place, words_aside, write_facts
from qdenv.io.files import tidy
from qdenv.types import InputError


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_name_nobody_gave_never_replaces_a_file(folder):
    names = []
    for _ in range(3):
        target = place(None, "plan.json")
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
    beside = place(Path("table.csv"), "x.csv").beside(".png", "_frames")
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


def test_facts_say_what_they_are_of(folder):
    write_facts(Path("f.json"), "simulate", {"throughput": 1.25}, layout=Path("p.txt"), agents=3)
    assert json.loads(Path("f.json").read_text()) == {
        "throughput": 1.25,
        "command": "simulate",
        "qdenv": metadata.version("qdenv"),
        "settings": {"layout": "p.txt", "agents": 3},
    }


def test_a_dash_is_standard_output_where_nothing_else_is_written_then(capsys):
    with words_aside():
        print("words")
        write_facts(Path("-"), "check", {"valid": True})
    said = capsys.readouterr()
    assert said.err == "words\n"
    assert json.loads(said.out)["valid"] is True
