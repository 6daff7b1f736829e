"""Pictures, sheets of Excel and CAD: read back as written, and as people draw them."""

import io

import numpy as np
import pytest
from conftest import read_layout
from PIL import Image
from small_warehouse import ROWS, TILES

from qdenv.cli.main import run as qdenv
from qdenv.domains.base import DOMAINS, find_domain
from qdenv.grid import draw
from qdenv.io.formats import write_drawing
from qdenv.io.images import COLOURS
from qdenv.io.layouts import MAX_SIDE, Drawing, read_drawing
from qdenv.types import InputError, Tile

DOMAIN_NAMES = [name for name in DOMAINS.names() if name != "garden"]
LIBRARIES = {".png": "PIL", ".xlsx": "openpyxl", ".dxf": "ezdxf"}
EVEN = find_domain("warehouse-even")


@pytest.mark.slow
@pytest.mark.parametrize("name", DOMAIN_NAMES)
@pytest.mark.parametrize("ending", LIBRARIES)
def test_what_was_written_comes_back(name, ending, tmp_path):
    pytest.importorskip(LIBRARIES[ending])
    domain, rng, path = find_domain(name), np.random.default_rng(3), tmp_path / f"l{ending}"
    for shape in [(1, 1), (1, 7), (5, 9)]:
        layout = rng.integers(0, len(domain.tiles), shape).astype(np.int8)
        drawing = Drawing(draw(layout, domain.tiles))
        assert write_drawing(path, drawing, domain.meanings) == []
        again = read_layout(path, domain.tiles, domain.meanings)
        np.testing.assert_array_equal(again, layout)


@pytest.mark.parametrize("names", ["Rack rack", "rack/shelf wall", "floor wall"])
def test_a_drawing_of_tiles_with_names_that_dxf_does_not_know_apart_comes_back(names, tmp_path):
    pytest.importorskip("ezdxf")
    meanings = dict(zip("@x", map(Tile, names.split()), strict=True))
    assert write_drawing(tmp_path / "l.dxf", Drawing(["@x.", "x@@"]), meanings) == []
    assert read_drawing(tmp_path / "l.dxf").rows == ["@x.", "x@@"]


@pytest.mark.parametrize("ending", LIBRARIES)
def test_commands_read_what_convert_writes(ending, tmp_path, capsys):
    pytest.importorskip(LIBRARIES[ending])
    plain, path = tmp_path / "plan.txt", tmp_path / f"plan{ending}"
    plain.write_text("\n".join(ROWS))
    assert qdenv(["convert", str(plain), str(path), "--cell", "1.2"]) == 0
    assert ("facts (cell) are left out" in capsys.readouterr().out) == (ending != ".dxf")
    assert qdenv(["check", str(path)]) == qdenv(["check", str(plain)])
    lines = capsys.readouterr().out.replace(str(path), str(plain)).splitlines()
    assert lines[: len(lines) // 2] == lines[len(lines) // 2 :]


@pytest.mark.parametrize("ending", [".xlsx", ".dxf"])
def test_commands_write_what_people_came_with(ending, tmp_path, capsys):
    pytest.importorskip(LIBRARIES[ending])
    path = tmp_path / f"human{ending}"
    assert qdenv(["layout", "human", "--rows", "9", "--cols", "12", "--out", str(path)]) == 0
    assert read_drawing(path).rows[1][0] == "w" and path.with_suffix(".png").exists()


def test_a_picture_from_a_paint_program_has_the_colours_of_tiles(tmp_path):
    pixels = np.array([[[255, 255, 255], [0x2B, 0x2B, 0x2B]], [[0x9D, 0xC3, 0xF2], [230, 159, 0]]])
    Image.fromarray(pixels.astype(np.uint8)).save(tmp_path / "a.png")
    assert read_drawing(tmp_path / "a.png").rows == [".@", "ew"]
    pixels[1, 0] = 1
    Image.fromarray(pixels.astype(np.uint8)).save(tmp_path / "a.png")
    reason = (
        "#010101 at row 1, column 0 is the colour of no tile: these are '#' #8a8a8a, '.' #ffffff"
    )
    with pytest.raises(InputError, match=reason):
        read_drawing(tmp_path / "a.png")
    assert len({*COLOURS.values()}) == len(COLOURS) - 2  # blanks, and walls of mazes


def test_a_huge_picture_is_refused_before_it_is_unpacked(tmp_path):
    file = io.BytesIO()
    Image.new("1", (MAX_SIDE + 1, MAX_SIDE)).save(file, "PNG")
    (tmp_path / "a.png").write_bytes(file.getvalue())
    with pytest.raises(InputError, match="not supported"):
        read_drawing(tmp_path / "a.png")


def test_a_sheet_may_have_numbers_colours_around_it_and_other_sheets(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.append(["e", 0, None, " @ "])
    book.active.append([None, "w"])
    book.active.cell(9, 9).fill = openpyxl.styles.PatternFill("solid", fgColor="ff0000")
    book.create_sheet("prices").append([3])
    book.save(tmp_path / "a.xlsx")
    drawing = read_drawing(tmp_path / "a.xlsx")
    assert drawing.rows == ["e0 @", " w  "]
    assert drawing.lost == ("sheets beyond the first one (prices) are",)
    book.active.append(["shelf"])
    book.save(tmp_path / "a.xlsx")
    with pytest.raises(InputError, match="'shelf' at row 9, column 0: a cell holds one tile"):
        read_drawing(tmp_path / "a.xlsx")
    book.active.delete_rows(10)
    book.active.merge_cells("A1:B1")
    book.save(tmp_path / "a.xlsx")
    with pytest.raises(InputError, match="merged cells hold one tile: split them"):
        read_drawing(tmp_path / "a.xlsx")


@pytest.fixture
def drawn(tmp_path):
    """A drawing of an engineer: millimetres, an L of racks, a round column, texts, a far origin."""
    ezdxf = pytest.importorskip("ezdxf")
    document = ezdxf.new("R2010", units=ezdxf.units.MM)
    space, corner = document.modelspace(), np.array([50_000, -20_000])

    def outline(layer, *points, closed=True):
        places = [tuple(corner + np.array(point) * 1000) for point in points]
        space.add_lwpolyline(places, close=closed, dxfattribs={"layer": layer})

    outline("HALL", (0, 0), (8, 0), (8, 6), (0, 6))
    outline("Racks", (2, 2), (6, 2), (6, 4), (4, 4), (4, 6), (2, 6), (2, 2), closed=False)
    outline("COLUMNS", *[(7 + np.cos(a), 5 + np.sin(a)) for a in np.linspace(0, 6, 20)])
    outline("DOORS", (0, 0), (1, 0), closed=False)
    space.add_text("north")
    document.saveas(tmp_path / "hall.dxf")
    return tmp_path / "hall.dxf"


def test_old_drawings_have_a_page_of_codes_and_shapes_may_be_seen_from_below(tmp_path):
    ezdxf = pytest.importorskip("ezdxf")
    document = ezdxf.new("R2000")
    space, below = document.modelspace(), {"extrusion": (0, 0, -1)}
    floor, column = [(0, 0), (4, 0), (4, 2), (0, 2)], [(-1, 0), (-2, 0), (-2, 1), (-1, 1)]
    space.add_lwpolyline(floor, close=True, dxfattribs={"layer": "HALLE"})
    space.add_lwpolyline(column, close=True, dxfattribs={"layer": "STÜTZEN"} | below)
    space.add_polyline2d(column, close=True, dxfattribs={"layer": "STÜTZEN"} | below)
    document.saveas(tmp_path / "hall.dxf")
    facts = 'cell = 1\nlayers = {HALLE = ".", "STÜTZEN" = "#"}'
    (tmp_path / "hall.toml").write_text(facts, encoding="utf-8")
    drawing = read_drawing(tmp_path / "hall.dxf")
    assert drawing.rows == ["....", ".#.."] and drawing.lost == ()


def test_a_drawing_of_cad_is_read_by_the_layers_named_beside_it(drawn, capsys):
    with pytest.raises(InputError, match="beside it with its layers, like layers"):
        read_drawing(drawn)
    layers = 'layers = {HALL = ".", RACKS = "@", columns = "#"}\n'
    drawn.with_suffix(".toml").write_text(f"cell = 2.0\n{layers}")
    drawing = read_drawing(drawn)
    assert drawing.rows == [".@.#", ".@@.", "...."]
    assert drawing.details["cell"] == 2.0 and drawing.lost == ("2 shapes (0, doors) are",)
    drawn.with_suffix(".toml").write_text(f"cell = 1\n{layers}")
    assert (
        read_drawing(drawn).rows == ["..@@..##", "..@@..##", "..@@@@..", "..@@@@.."] + ["." * 8] * 2
    )
    assert qdenv(["check", str(drawn)]) == 1  # read by every command
    assert "unknown fact" not in capsys.readouterr().err
    for content, reason in [
        ("cell = 0.001", "not supported"),
        ("cell = 0.0001", "0.001 to 1000 metres"),
        ("cell = ", "cannot be read"),
        ('cell = 1\nlayers = {A = "@"}', "no closed polyline on the layers A"),
    ]:
        more = layers if "layers" not in content else ""
        drawn.with_suffix(".toml").write_text(f"{content}\n{more}")
        with pytest.raises(InputError, match=reason):
            read_drawing(drawn)


def test_facts_of_a_drawing_are_an_object(tmp_path):
    ezdxf = pytest.importorskip("ezdxf")
    document = ezdxf.new()
    document.header.custom_vars.append("qdenv", "[1]")
    document.saveas(tmp_path / "hall.dxf")
    with pytest.raises(InputError, match="not a DXF drawing"):
        read_drawing(tmp_path / "hall.dxf")


def test_without_the_library_a_line_names_the_extra(tmp_path, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    for ending in (".xlsx", ".dxf"):
        with pytest.raises(InputError, match=r'pip install "qdenv\[formats\]"'):
            write_drawing(tmp_path / f"a{ending}", Drawing(["."]), EVEN.meanings)
    assert EVEN.tiles == TILES
