"""Layout files: the round trip, the published files, and one clear line for each bad file."""

import json

import numpy as np
import pytest
from conftest import read_layout
from hypothesis import given, settings
from hypothesis import strategies as st

from qdenv.domains.base import DOMAINS, find_domain
from qdenv.grid import draw, parse
from qdenv.io.layouts import (
    ENDINGS,
    MAX_SIDE,
    alphabet,
    endings_for,
    read_drawing,
    write_layout,
)
from qdenv.types import InputError

TILES = ".@ew"
WAREHOUSE, MAZE = find_domain("warehouse-even"), find_domain("maze-walls")
DRAWN = ["w..@", ".ee.", "....", "@.ew"]


def test_missing_folder_and_huge_files(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        read_layout(tmp_path / "nothing.json", TILES)
    with pytest.raises(InputError, match="cannot be read"):
        read_layout(tmp_path, TILES)
    huge = tmp_path / "huge.json"
    with huge.open("wb") as file:
        file.truncate(2**30)
    with pytest.raises(InputError, match="bigger than"):
        read_layout(huge, TILES)


@pytest.mark.parametrize(
    ("name", "domain"),
    [("warehouse_even_unrepaired", "warehouse-even"), ("manufacturing", "manufacturing")],
)
def test_a_layout_file_with_other_keys_reads_and_is_written_back_alike(
    name, domain, own_layout, tmp_path
):
    path, tiles = own_layout(name), find_domain(domain).tiles
    content = json.loads(path.read_text())
    details = {key: content[key] for key in content if key not in ("n_row", "n_col", "layout")}
    assert details["domain"] == domain
    write_layout(tmp_path / "again.json", read_layout(path, tiles), tiles, **details)
    assert (tmp_path / "again.json").read_bytes() == path.read_bytes()


DOMAIN_NAMES = [name for name in DOMAINS.names() if name != "garden"]


@pytest.mark.parametrize("name", DOMAIN_NAMES)
@pytest.mark.parametrize("ending", [".json", ".txt", ".csv", ".map"])
def test_every_format_gives_back_what_was_written(name, ending, tmp_path):
    domain, rng = find_domain(name), np.random.default_rng(3)
    kinds = len(domain.tiles) if ending in endings_for(domain.tiles, domain.meanings) else 2
    if ending == ".map" and name in ("manufacturing", "hall"):
        kinds = 1  # no wall, no map of one
    for rows, cols in [(1, 1), (1, 7), (6, 1), (5, 9), (33, 36)]:
        layout = rng.integers(0, kinds, (rows, cols)).astype(np.int8)
        path = tmp_path / f"l{ending.upper()}"
        write_layout(path, layout, domain.tiles, domain.meanings)
        again = read_layout(path, domain.tiles, domain.meanings)
        np.testing.assert_array_equal(again, layout)


@settings(max_examples=60, deadline=None)
@given(
    rows=st.integers(1, 5).flatmap(
        lambda width: st.lists(st.text(" X", min_size=width, max_size=width), min_size=1)
    ),
    ending=st.sampled_from([".txt", ".csv", ".map"]),
)
def test_mazes_of_blanks_survive_every_format(rows, ending, tmp_path_factory):
    path = tmp_path_factory.mktemp("maze") / f"m{ending}"
    write_layout(path, parse(rows, MAZE.tiles), MAZE.tiles, MAZE.meanings)
    assert draw(read_layout(path, MAZE.tiles, MAZE.meanings), MAZE.tiles) == rows


WRITTEN = {
    "a list.json": json.dumps(DRAWN),
    "mark.json": b"\xef\xbb\xbf" + json.dumps({"layout": DRAWN}).encode(),
    "unix.txt": "\n".join(DRAWN),
    "windows.txt": "\r\n".join(["", *DRAWN, "", "  ", ""]),
    "old mac.txt": "\r".join(DRAWN),
    "shell.txt": "\n".join(DRAWN).encode("utf-16"),
    "mark.txt": b"\xef\xbb\xbf" + "\n".join(DRAWN).encode(),
    "walls.txt": "\n".join(DRAWN).replace("@", "#").replace(".", " "),
    "comma.csv": "\n".join(",".join(row) for row in DRAWN),
    "semicolon.csv": "\r\n".join(";".join(row) for row in DRAWN) + "\r\n",
    "excel.csv": "\ufeffsep=;\r\n" + "\r\n".join(";".join(row) for row in DRAWN).replace(".", ""),
    "quoted.csv": "\n".join(",".join(f'"{tile}"' for tile in row) for row in DRAWN),
    "rows.csv": "\n".join(DRAWN) + "\n",
    "UPPER.CSV": "\n".join("\t".join(row) for row in DRAWN),
    "bench.map": "type octile\nheight 4\nwidth 4\nmap\n" + "\n".join(DRAWN),
}


@pytest.mark.parametrize("name", WRITTEN)
def test_whatever_program_wrote_it_the_rows_are_the_same(name, tmp_path):
    content = WRITTEN[name]
    (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    layout = read_layout(tmp_path / name, WAREHOUSE.tiles, WAREHOUSE.meanings)
    assert draw(layout, TILES) == DRAWN


def test_a_map_of_the_benchmarks_is_a_maze_and_a_warehouse_without_stations(tmp_path):
    path = tmp_path / "m.map"
    path.write_text("type octile\r\nheight 2\r\nwidth 6\r\nmap\r\n.GS@OT\r\nW....W\r\n\r\n")
    maze = read_layout(path, MAZE.tiles, MAZE.meanings)
    assert draw(maze, MAZE.tiles) == ["   XXX", "X    X"]
    assert draw(read_layout(path, TILES, WAREHOUSE.meanings), TILES) == ["...@@@", "@....@"]
    with pytest.raises(InputError, match="unknown tile '#' at row 0, column 3: this domain knows"):
        factory = find_domain("manufacturing")
        read_layout(path, factory.tiles, factory.meanings)


def test_a_maze_drawn_with_hashes_is_one(tmp_path):
    (tmp_path / "m.txt").write_text("#.#\n# #\n###\n")
    layout = read_layout(tmp_path / "m.txt", MAZE.tiles, MAZE.meanings)
    assert draw(layout, MAZE.tiles) == ["X X", "X X", "XXX"]


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("a.txt", "", "empty"),
        ("a.txt", "..\n...", "row 1 of the layout has 3 tiles, row 0 has 2"),
        ("a.txt", ".@\n.q", "unknown tile 'q' at row 1, column 1.*'@' shelf, 'e' endpoint"),
        ("a.txt", b"\xff\xff", "not a text file"),
        ("a.csv", ".,@\n.,shelf", "'shelf' at row 1, column 1: a cell holds one tile"),
        ("a.csv", '.,"@\n', "not a CSV file"),
        ("a.map", "....\n....", "not a MovingAI map"),
        ("a.map", "type octile\nheight 3\nwidth 2\nmap\n..\n..", "says height 3, the map has 2"),
        ("a.txt", "." * (MAX_SIDE + 1), "not supported"),
        ("a.csv", "\n".join("." * (MAX_SIDE + 1)), "not supported"),
        ("a.json", "", "not a JSON file"),
        ("a.json", "[1, 2", "not a JSON file"),
        ("a.json", "[" * 100_000, "not a JSON file"),
        ("a.json", '{"rows": []}', "list of strings"),
        ("a.json", '{"layout": [".."], "facts": 5}', "must be an object, not 5"),
        ("a.json", '{"layout": [".."], "starts": [0], "tasks": [[]]}', "a task has no cell"),
        ("a.json", '{"layout": "..."}', "list of strings"),
        ("a.json", '{"layout": [[1]]}', "list of strings"),
        ("a.json", '{"layout": []}', "empty"),
        ("a.json", '{"layout": [""]}', "empty"),
        ("a.json", '{"layout": ["..", "."]}', "row 1 of the layout has 1 tiles, row 0 has 2"),
        ("a.json", '{"layout": [".x"]}', "unknown tile 'x' at row 0, column 1"),
        ("a.json", json.dumps({"layout": ["." * (MAX_SIDE + 1)]}), "not supported"),
        ("a.json", b"\xff\xfe\x00", "not a JSON file"),
        ("a.json", json.dumps({"layout": [".@", ".\ud800"]}), "unknown tile"),
        ("a.json", "1" * 5000, "not a JSON file"),
        ("a.docx", "PK", r"layouts end in .json, .txt, .csv, .map"),
    ],
)
def test_bad_files_of_every_format_are_refused_in_one_line(name, content, reason, tmp_path):
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(InputError, match=reason) as error:
        read_layout(path, TILES, WAREHOUSE.meanings)
    assert str(path) in str(error.value) and "\n" not in str(error.value)


def test_a_map_is_refused_where_it_would_lose_tiles(tmp_path):
    path = tmp_path / "w.map"
    with pytest.raises(InputError, match=r"'e' endpoint, 'w' workstation: write a \.json"):
        write_layout(path, parse(DRAWN, TILES), TILES, WAREHOUSE.meanings)
    assert not path.exists()
    write_layout(path, parse(["..@"], TILES), TILES, WAREHOUSE.meanings)
    assert path.read_text() == "type octile\nheight 1\nwidth 3\nmap\n..@\n"
    assert ".map" in endings_for(MAZE.tiles, MAZE.meanings)
    assert ".map" not in endings_for(WAREHOUSE.tiles, WAREHOUSE.meanings)


def test_what_can_be_written_can_be_read(tmp_path):
    largest = np.zeros((1, MAX_SIDE), np.int8)
    for ending in ENDINGS:
        path = tmp_path / f"l{ending}"
        write_layout(path, largest, WAREHOUSE.tiles, WAREHOUSE.meanings)
        assert read_layout(path, WAREHOUSE.tiles, WAREHOUSE.meanings).shape == largest.shape
        with pytest.raises(InputError, match="more than 1000 rows or columns"):
            write_layout(path, np.zeros((MAX_SIDE + 1, 1), np.int8), TILES)


def test_a_file_says_whose_it_is_and_plain_formats_say_nothing(tmp_path):
    for ending in ENDINGS:
        path = tmp_path / f"m{ending}"
        write_layout(path, parse(["X "], " X"), " X", MAZE.meanings, domain="maze-walls")
        assert read_drawing(path)[1] == ("maze-walls" if ending == ".json" else None)


def test_an_alphabet_is_listed_with_its_meanings():
    said = alphabet(WAREHOUSE.tiles, WAREHOUSE.meanings)
    assert said == "'.' floor, '@' shelf, 'e' endpoint, 'w' workstation"
    assert alphabet("?!", {}) == "'?', '!'"


PIECES = [
    *'.@ewX #\n,;"{}[]',
    "\r\n",
    "map\n",
    "height 2\n",
    "sep=;\n",
    "sep=\n",
    '"layout":',
    "\0",
]


@settings(max_examples=300, deadline=None)
@given(pieces=st.lists(st.sampled_from(PIECES), max_size=30), ending=st.sampled_from(ENDINGS))
def test_no_text_gets_more_than_one_line_of_refusal(pieces, ending, tmp_path_factory):
    path = tmp_path_factory.getbasetemp() / f"any{ending}"
    path.write_text("".join(pieces), newline="")
    try:
        layout = read_layout(path, TILES, WAREHOUSE.meanings)
    except InputError as error:
        assert str(error).startswith(str(path)) and "\n" not in str(error)
    else:
        assert layout.dtype == np.int8 and layout.size and layout.max() < len(TILES)
