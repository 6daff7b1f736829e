"""Where results go: named, said, never over one another; facts that explain themselves."""

import json
import math
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from importlib import metadata
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from small_warehouse import ROWS

from qdenv.cli.main import run
from qdenv.interrupt import discard_unfinished
from qdenv.io.files import reserve, tidy, write_json
from qdenv.ops.output import AUTO, PICTURES, Place, format_table, place, place_folder
from qdenv.shipped import HOME
from qdenv.types import InputError


def test_a_name_nobody_gave_never_replaces_a_file(folder):
    (folder / "plan.png").touch()
    first, second, third = (place(AUTO, "plan.json") for _ in range(3))  # nothing is written yet
    assert list(map(str, (first, second, third))) == ["plan.json", "plan-2.json", "plan-3.json"]
    beside = [str(one.beside(".png")) for one in (third, first)]
    assert beside == ["plan-3.png", "plan-2.png"]
    # What was written stays at the end of the program, and what is nobody's own goes.
    write_json(first.path, 1)
    discard_unfinished()
    assert sorted(os.listdir()) == ["plan.json", "plan.png"]


def test_side_by_side_nobody_gets_the_name_of_another(folder):
    with ThreadPoolExecutor(8) as pool:
        names = list(pool.map(lambda _: place(AUTO, "plan.json").path.name, range(40)))
    assert len(set(names)) == 40 == len(os.listdir())


def test_folders_of_one_name_are_two_and_empty_ones_go(folder):
    made = [reserve(Path("runs") / "quick-1", folder=True) for _ in range(2)]
    assert list(map(str, made)) == ["runs/quick-1", "runs/quick-1-2"]
    discard_unfinished()
    assert os.listdir() == []
    assert [str(place_folder(out, "series")) for out in (True, AUTO, "auto", "x")] == [
        "series",
        "series-2",
        "series-3",
        "x",
    ]
    discard_unfinished()
    full = reserve(Path("runs") / "quick-1", folder=True)
    (full / "file").touch()
    discard_unfinished()
    assert (full / "file").exists()


def test_facts_that_cannot_be_written_stop_a_command_before_it_writes(folder, capsys):
    Path("sealed.json").touch(0o444)
    with mock.patch("os.access", lambda path, mode: Path(path).name != "sealed.json"):
        line = ["layout", "human", "--rows", "20", "--cols", "20", "--json", "sealed.json"]
        assert run(line) == 2
    assert "cannot be written (sealed.json is read-only)" in capsys.readouterr().err
    assert os.listdir() == ["sealed.json"]


@pytest.mark.slow
def test_standard_output_by_its_name_is_a_stream(folder):
    Path("p.txt").write_text("\n".join(ROWS))
    Path("log").write_text("old\n")
    Path("link").symlink_to("/dev/stdout")
    for name in ("/proc/thread-self/fd/1", "/dev/stdout", "link"):
        command = [sys.executable, "-m", "qdenv", "check", "p.txt", "--json", name]
        with open("log", "a") as log:
            assert subprocess.run(command, stdout=log).returncode == 0
    lines = Path("log").read_text().splitlines()
    assert lines[0] == "old" and Path("link").is_symlink()
    assert sum(line.startswith("p.txt, a hall: obeys") for line in lines) == 3
    assert sum('"valid": true' in line for line in lines) == 3
    assert lines[-1] == "link"  # "replaced" it is not


def test_a_file_that_is_named_may_be_replaced_and_that_is_said(folder):
    assert str(place(Path("new.json"), "plan.json")) == "new.json"
    (folder / "new.json").touch()
    assert str(place(Path("new.json"), "plan.json")) == "new.json (replaced)"


def test_a_picture_lies_beside_its_data(folder):
    assert place(Path("a/table.csv"), "x.csv").beside(".png") == Place(Path("a/table.png"), False)
    (folder / "table.png").write_text("of somebody else, there before the table")
    beside = place(Path("table.csv"), "x.csv").beside(".png")
    assert beside == Place(Path("table-2.png"), False, True)
    (folder / "table.csv").touch()
    beside = place(Path("table.csv"), "x.csv").beside(".png")
    assert beside == Place(Path("table.png"), True)


@pytest.mark.parametrize(
    ("out", "endings", "said"),
    [
        ("plan.png", (), "a picture's name: name the data plan.json"),
        ("plan.SVG", (), "a picture's name"),
        ("plan.jpg", (), "a picture's name"),
        ("plan.json", PICTURES, r"ends in .png or .svg or .pdf"),
        ("folder", (), "that is a folder: name a file in it, like folder/plan.json"),
        ("read.json", (), "that is what is read"),
        ("link.json", (), "that is what is read"),
        ("read.json/plan.json", (), "read.json is a file"),
        (HOME / "maze-walls" / "metrics.csv", (".csv",), "ships with qdenv"),
    ],
)
def test_names_that_would_lose_something_are_refused(folder, out, endings, said):
    (folder / "folder").mkdir()
    (folder / "read.json").touch()
    (folder / "link.json").symlink_to("read.json")
    with pytest.raises(InputError, match=said):
        place(Path(out), "plan.json", endings, ["0:9,0:9+" * 40, Path("read.json")])


def test_a_file_may_have_commas_in_its_name(folder):
    for name in ("a,b.json", "b.json"):
        Path(name).touch()
    beside = place(Path("b.json"), "plan.json", inputs=[Path("a,b.json")])
    assert beside == Place(Path("b.json"), True, read=[Path("a,b.json")])
    for stated, name in {"w+a,b.json": "a,b.json", "b.json,c.json": "b.json"}.items():
        with pytest.raises(InputError, match="that is what is read"):
            place(Path(name), "plan.json", inputs=[stated])


@pytest.mark.parametrize(
    "line",
    [
        *(f"check plan.txt --json {name}" for name in ("keep.txt", "odds.csv", "plan.toml")),
        "check m.scen --json m.map",
        "export run --out run/metrics.csv",
    ],
)
def test_what_an_input_names_or_has_beside_it_is_not_replaced(folder, capsys, line):
    Path("plan.txt").write_text("\n".join(ROWS))
    Path("plan.toml").write_text('keep = "w+keep.txt"\ndemand = "odds.csv"\n')
    Path("run").mkdir()
    for name in ("keep.txt", "odds.csv", "m.map", "m.scen", "run/metrics.csv"):
        Path(name).touch()
    assert run(line.split()) == 2
    assert (
        f"{line.split()[-1]}: that is what is read: choose another name" in capsys.readouterr().err
    )


def test_a_picture_beside_a_table_does_not_replace_what_is_read(folder):
    for name in ("p.csv", "p.png"):
        Path(name).touch()
    assert str(place(Path("p.csv"), "p.csv", inputs=["p.png"]).beside(".png")) == "p-2.png"


@pytest.mark.parametrize(
    "line", ["check p.txt --keep k.txt", "generate zoo:maze-walls --plan k.txt"]
)
def test_facts_replace_no_file_that_is_read(line, folder, capsys):
    Path("p.txt").write_text("\n".join(ROWS))
    Path("k.txt").write_text("\n".join(ROWS))
    assert run([*line.split(), "--json", "k.txt"]) == 2
    assert "k.txt: " in capsys.readouterr().err
    assert Path("k.txt").read_text() == "\n".join(ROWS)


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
    facts = json.loads(Path("f.json").read_text())
    assert facts.pop("remarks")  # what can be built
    assert facts == {
        "valid": True,
        "rules": True,
        "broken": [],
        "holds": [],
        "command": "check",
        "qdenv": metadata.version("qdenv"),
        "settings": {"layout": "p.txt", "domain": "hall", "keep": None, "numbers": {}},
    }
    # A dash is standard output, where nothing else is written then.
    capsys.readouterr()
    assert run(["check", "p.txt", "--json", "-"]) == 0
    printed = capsys.readouterr()
    assert "obeys every rule" in printed.err
    assert json.loads(printed.out)["valid"] is True


def test_columns_of_a_table_are_as_wide_as_their_widest_cell():
    assert format_table([("a", "bb"), (100, "c"), ("x", "")]) == ["a    bb", "100  c", "x"]
