"""Layout files: the round trip, the published files, and one clear line for each bad file."""

import json

import numpy as np
import pytest

from qdenv.domains.base import find_domain
from qdenv.formats.drawings import MAX_SIDE
from qdenv.formats.layouts import read_layout, write_layout
from qdenv.types import InputError

TILES = ".@ew"


def test_round_trip(tmp_path):
    layout = np.random.default_rng(0).integers(0, 4, (5, 7)).astype(np.int8)
    write_layout(tmp_path / "l.json", layout, TILES, name="mine")
    np.testing.assert_array_equal(read_layout(tmp_path / "l.json", TILES), layout)
    content = json.loads((tmp_path / "l.json").read_text())
    assert content["n_row"] == 5 and content["n_col"] == 7 and content["name"] == "mine"


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("", "not a JSON file"),
        ("[1, 2", "not a JSON file"),
        ("[" * 100_000, "not a JSON file"),
        ('{"rows": []}', "list of strings"),
        ('{"layout": "..."}', "list of strings"),
        ('{"layout": [[1]]}', "list of strings"),
        ('{"layout": []}', "empty"),
        ('{"layout": [""]}', "empty"),
        ('{"layout": ["..", "."]}', "row 1 of the layout has 1 tiles, row 0 has 2"),
        ('{"layout": [".x"]}', "unknown tile 'x' at row 0, column 1"),
        (json.dumps({"layout": ["." * (MAX_SIDE + 1)]}), "not supported"),
        (b"\xff\xfe\x00", "not a JSON file"),
    ],
)
def test_bad_files_are_refused_in_one_line(content, reason, tmp_path):
    path = tmp_path / "bad.json"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(InputError, match=reason) as error:
        read_layout(path, TILES)
    assert str(path) in str(error.value) and "\n" not in str(error.value)


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
    ("name", "domain", "shape"),
    [
        ("warehouse_even_nca_a5", "warehouse-even", (33, 36)),
        ("warehouse_uneven_nca_a5", "warehouse-uneven", (33, 36)),
        ("warehouse_human_eval", "warehouse-even", (101, 102)),
        ("manufacturing_nca_a5", "manufacturing", (33, 36)),
    ],
)
def test_published_layouts_read(name, domain, shape, published):
    assert read_layout(published(name), find_domain(domain).tiles).shape == shape


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
