"""Road maps: LIF by its public schema and its readers; Open-RMF, Nav2 and ROS by what they read."""

import importlib
import json

import numpy as np
import pytest
from conftest import STUDY_DATA
from small_warehouse import ROWS, TILES

from qdenv.cli.main import run as qdenv
from qdenv.domains.base import find_domain
from qdenv.grid import MOVES, parse
from qdenv.guidance import existing_moves
from qdenv.io.layouts import write_layout

EVEN = find_domain("warehouse-even")
FREE = EVEN.drivable(parse(ROWS, TILES))
HEIGHT = len(FREE)
SCHEMA = STUDY_DATA / "formats" / "LIF.schema"


@pytest.fixture(scope="module")
def costs():
    """Costs of moves: some dear, the way from the second cell to the first is not allowed."""
    costs = np.where(existing_moves(FREE), 1.0, np.inf)
    costs[2, 0, 1], costs[1, 0, 2] = np.inf, 7.0
    return costs


@pytest.fixture(scope="module")
def plan(tmp_path_factory, costs):
    path = tmp_path_factory.mktemp("lanes") / "plan.json"
    details = {"domain": EVEN.name, "name": "north hall"}
    write_layout(path, parse(ROWS, TILES), TILES, EVEN.meanings, costs, **details)
    return path


def expected_moves(costs):
    """Return (row, col, row, col) of all moves allowed, worked out cell by cell."""
    cells = [(row, col) for row, col in np.ndindex(FREE.shape) if FREE[row, col]]
    return {
        (row, col, row + down, col + right)
        for row, col in cells
        for kind, (down, right) in enumerate(MOVES, 1)
        if (row + down, col + right) in cells and np.isfinite(costs[kind, row, col])
    }


def cell_of(x, y, side=1.2):
    return round(HEIGHT - y / side - 0.5), round(x / side - 0.5)


def written(plan, name, *options):
    target = plan.with_name(name)
    assert qdenv(["convert", str(plan), str(target), "--cell", "1.2", *options]) == 0
    return target


@pytest.fixture(scope="module")
def lif(plan):
    return json.loads(written(plan, "plan.lif").read_text())


def test_lif_has_a_node_for_each_free_cell_and_an_edge_for_each_move_allowed(lif, costs):
    (layout,) = lif["layouts"]
    cells = {one["nodeId"]: cell_of(*one["nodePosition"].values()) for one in layout["nodes"]}
    assert [[*cell] for cell in cells.values()] == np.argwhere(FREE).tolist()
    edges = [(*cells[e["startNodeId"]], *cells[e["endNodeId"]]) for e in layout["edges"]]
    assert len(edges) == len({*edges}) and {*edges} == expected_moves(costs)
    assert (0, 0, 0, 1) in edges and (0, 1, 0, 0) not in edges
    places = [cells[node] for one in layout["stations"] for node in one["interactionNodeIds"]]
    assert {ROWS[row][col] for row, col in places} == {"e", "w"}
    assert len(places) == sum(row.count("e") + row.count("w") for row in ROWS)
    assert layout["layoutId"] == "north hall"


def test_lif_obeys_the_public_schema(lif):
    jsonschema = pytest.importorskip("jsonschema")
    if not SCHEMA.exists():
        pytest.skip("no schema here (QDENV_STUDY_DATA names its folder)")
    jsonschema.validate(lif, json.loads(SCHEMA.read_text()))
    del lif["layouts"][0]["nodes"][0]["nodePosition"]
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(lif, json.loads(SCHEMA.read_text()))


@pytest.mark.filterwarnings("ignore")  # of somebody else's library
def test_lif_is_read_by_public_readers(plan, costs):
    path = written(plan, "again.lif.json")
    vdma = pytest.importorskip("vdma_lif.parser").LIFParser.from_file(str(path))
    assert len(vdma.layouts[0].edges) == len(expected_moves(costs))
    pytest.importorskip("lif_reader.lif_reader")
    graph = importlib.import_module("lif_reader.graph.lif_graph").LIFGraph()
    importlib.import_module("lif_reader.lif_reader").LIFReader(graph).parse_lif_file(str(path))
    roads = graph.layouts["north hall"]
    assert len(roads.nodes) == FREE.sum() and len(roads.edges) == len(expected_moves(costs))
    assert graph.get_shortest_path("r0c0", "r0c2", "north hall") == ["r0c0", "r0c1", "r0c2"]
    assert len(graph.get_shortest_path("r0c1", "r0c0", "north hall")) == 4  # against the one-way


def test_open_rmf_reads_vertices_and_lanes_by_number(plan, costs):
    yaml = pytest.importorskip("yaml")
    content = yaml.safe_load(written(plan, "graph.yaml", "--format", "rmf").read_text())
    assert content["building_name"] == "north hall" and content["lifts"] == {}
    level = content["levels"]["L1"]
    cells = [cell_of(x, y) for x, y, _ in level["vertices"]]
    assert {(*cells[a], *cells[b]) for a, b, _ in level["lanes"]} == expected_moves(costs)
    names = [facts["name"] for *_, facts in level["vertices"] if facts["name"]]
    assert len(names) == len({*names}) and "workstation r1c0" in names


@pytest.mark.parametrize(("name", "key"), [("a.lif", "nodeName"), ("a.geojson", "tile")])
def test_a_road_map_of_tiles_without_names_has_their_symbols(name, key, tmp_path):
    write_layout(tmp_path / name, parse(ROWS, TILES), TILES)
    assert f'"{key}": "w"' in (tmp_path / name).read_text()


def test_nav2_reads_ids_ends_and_costs_of_edges(plan, costs, capsys):
    features = json.loads(written(plan, "plan.geojson").read_text())["features"]
    assert "costs of moves" not in capsys.readouterr().out
    facts = [one["properties"] for one in features]
    assert [one["id"] for one in facts] == list(range(len(features)))  # nodes and edges share ids
    places = [one["geometry"]["coordinates"] for one in features]
    kinds = [one["geometry"]["type"] for one in features]
    cells = [cell_of(*place) for place, kind in zip(places, kinds, strict=True) if kind == "Point"]
    edges = facts[len(cells) :]
    moves = {(*cells[e["startid"]], *cells[e["endid"]]): e["cost"] for e in edges}
    assert moves.keys() == expected_moves(costs) and moves[0, 2, 0, 3] == 7.0
    assert places[-1] == [[places[edges[-1]["startid"]], places[edges[-1]["endid"]]]]
    (plan.parent / "bare.txt").write_text("..@\n")
    bare = json.loads(written(plan.parent / "bare.txt", "bare.geojson").read_text())["features"]
    for found, closable in ((edges, False), ([one["properties"] for one in bare[2:]], True)):
        assert {one["overridable"] for one in found} == {closable}  # while the robots drive


def test_ros_reads_a_picture_with_its_scale(plan):
    yaml, image = pytest.importorskip("yaml"), pytest.importorskip("PIL.Image")
    facts = yaml.safe_load(written(plan, "hall.yaml", "--format", "ros").read_text())
    assert facts["resolution"] == 1.2 and facts["origin"] == [0, 0, 0] and facts["negate"] == 0
    occupied = 1 - np.array(image.open(plan.with_name(facts["image"]))) / 255
    assert (occupied[FREE] < facts["free_thresh"]).all()
    assert (occupied[~FREE] > facts["occupied_thresh"]).all() and occupied.shape == FREE.shape
    assert written(plan, "other.pgm").read_bytes() == plan.with_name("hall.pgm").read_bytes()


def test_what_a_road_map_does_not_say_is_named(plan, capsys):
    written(plan, "b.lif")
    lines = capsys.readouterr().out.splitlines()
    dear = "lif: costs of moves (but for moves that are not allowed) are left out"
    assert lines[:2] == ["lif: obstacles (shelf) are left out", dear]
