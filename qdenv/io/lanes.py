"""Road maps for fleets: a node for each cell that robots drive on, an edge for each move allowed.

LIF is VDMA's Layout Interchange Format 1.0 (https://github.com/continua-systems/vdma-lif), beside
VDA 5050. Open-RMF reads navigation graphs (rmf_fleet_adapter, parse_graph.cpp), Nav2's route server
GeoJSON (nav2_route, geojson_graph_file_loader.cpp), ROS a picture of what is occupied
(map_server). Metres begin at the lower left corner of the layout, x to the right, y up.
"""

import json
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from qdenv.grid import move_steps
from qdenv.guidance import existing_moves
from qdenv.io.files import write_atomically, write_json
from qdenv.io.guidance import costs_of
from qdenv.io.layouts import BLANKS, Drawing, free_cells
from qdenv.types import InputError, Tile

_VEHICLE = "robot"  # the one type of vehicle

_Node = tuple[str, float, float]  # name of the tile, x and y of its centre in metres
_Edge = tuple[int, int, float]  # from node, to node, cost of the move


def _make_graph(
    path: Path, drawing: Drawing, meanings: Mapping[str, Tile]
) -> tuple[list[_Node], list[_Edge], list[str], list[int]]:
    """Turn free cells into nodes, and moves allowed into edges.

    Return both, the names of the nodes (their rows and columns), and those that are more than
    floor: the stations.
    """
    rows, free = drawing.rows, free_cells(drawing.rows, meanings)
    (height, width), side, weights = free.shape, side_of(path, drawing), drawing.weights
    costs = np.ones((5, height, width)) if weights is None else costs_of(weights, free)
    places = np.argwhere(free).tolist()
    symbols = [rows[row][col] for row, col in places]
    tiles = [meanings.get(symbol, Tile(symbol)).name for symbol in symbols]
    nodes = [
        (tile, round((col + 0.5) * side, 6), round((height - row - 0.5) * side, 6))
        for tile, (row, col) in zip(tiles, places, strict=True)
    ]
    number = np.cumsum(free).reshape(-1) - 1
    kind, row, col = np.nonzero(existing_moves(free)[1:] & np.isfinite(costs[1:]))
    begin = row * width + col
    end = begin + move_steps(width)[1:][kind]
    parts = number[begin].tolist(), number[end].tolist(), costs[1 + kind, row, col].tolist()
    edges = sorted(zip(*parts, strict=True))
    stations = [index for index, symbol in enumerate(symbols) if symbol not in BLANKS]
    return nodes, edges, [f"r{row}c{col}" for row, col in places], stations


def side_of(path: Path, drawing: Drawing) -> float:
    """Return the length of a cell's side in metres, 1 unless the drawing states it."""
    side = {**drawing.details.get("facts", {}), **drawing.details}.get("cell", 1.0)
    if isinstance(side, bool) or not isinstance(side, int | float) or not 1e-3 <= side <= 1e3:
        raise InputError(f"{path}: a cell's side is 0.001 to 1000 metres, not {side!r}")
    return float(side)


def _name_of(path: Path, drawing: Drawing) -> str:
    name = drawing.details.get("name")
    return name if isinstance(name, str) and name else path.name.partition(".")[0]


def _lost(
    drawing: Drawing, meanings: Mapping[str, Tile], edges: list[_Edge] | None = None
) -> list[str]:
    """Name the obstacles that no graph holds, and costs that only say what is dear."""
    used = {*"".join(drawing.rows)}
    names = [tile.name for symbol, tile in meanings.items() if symbol in used and tile.obstacle]
    lost = [f"obstacles ({', '.join(names)}) are"] * bool(names)
    if edges and len({cost for *_, cost in edges}) > 1:
        lost.append("costs of moves (but for moves that are not allowed) are")
    return lost


def write_lif(path: Path, drawing: Drawing, meanings: Mapping[str, Tile]) -> list[str]:
    """Write LIF; a station stands at each cell that is more than floor."""
    places, moves, names, stations = _make_graph(path, drawing, meanings)
    name = _name_of(path, drawing)
    nodes = [
        {
            "nodeId": place,
            "nodeName": tile,
            "mapId": name,
            "nodePosition": {"x": x, "y": y},
            "vehicleTypeNodeProperties": [{"vehicleTypeId": _VEHICLE}],
        }
        for place, (tile, x, y) in zip(names, places, strict=True)
    ]
    edges = [
        {
            "edgeId": f"{names[begin]}-{names[end]}",
            "startNodeId": names[begin],
            "endNodeId": names[end],
            "vehicleTypeEdgeProperties": [{"vehicleTypeId": _VEHICLE, "rotationAllowed": False}],
        }
        for begin, end, _ in moves
    ]
    served = [
        {
            "stationId": f"station-{nodes[one]['nodeId']}",
            "stationName": f"{nodes[one]['nodeName']} {nodes[one]['nodeId']}",
            "interactionNodeIds": [nodes[one]["nodeId"]],
            "stationPosition": nodes[one]["nodePosition"],
        }
        for one in stations
    ]
    now = datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
    meta = {"projectIdentification": name, "creator": "qdenv", "exportTimestamp": now}
    layout = {"layoutId": name, "layoutVersion": "1", "nodes": nodes, "edges": edges}
    layouts = [{**layout, "stations": served}]
    write_json(path, {"metaInformation": {**meta, "lifVersion": "1.0.0"}, "layouts": layouts})
    return _lost(drawing, meanings, moves)


def write_rmf(path: Path, drawing: Drawing, meanings: Mapping[str, Tile]) -> list[str]:
    """Write a navigation graph of Open-RMF: stations have names, each lane leads one way."""
    nodes, edges, names, stations = _make_graph(path, drawing, meanings)
    labels = {one: f"{nodes[one][0]} {names[one]}" for one in stations}
    vertices = [[x, y, {"name": labels.get(i, "")}] for i, (_, x, y) in enumerate(nodes)]
    lanes = [[begin, end, {}] for begin, end, _ in edges]
    lines = [f"building_name: {json.dumps(_name_of(path, drawing))}", "doors: {}", "lifts: {}"]
    lines += ["levels:", "  L1:"]
    # Flow style, which is JSON: one vertex or lane a line.
    for name, values in {"vertices": vertices, "lanes": lanes}.items():
        lines.append(f"    {name}:" if values else f"    {name}: []")
        lines += [f"      - {json.dumps(value)}" for value in values]
    write_atomically(path, ("\n".join(lines) + "\n").encode())
    return _lost(drawing, meanings, edges)


def write_nav2(path: Path, drawing: Drawing, meanings: Mapping[str, Tile]) -> list[str]:
    """Write a graph of Nav2's route server with the costs of moves as those of edges."""
    nodes, edges, names, _ = _make_graph(path, drawing, meanings)
    features: list[dict[str, Any]] = []
    for one, (tile, x, y) in enumerate(nodes):
        facts = {"id": one, "frame": "map", "metadata": {"tile": tile, "cell": names[one]}}
        place = {"type": "Point", "coordinates": [x, y]}
        features.append({"type": "Feature", "properties": facts, "geometry": place})
    for number, (begin, end, cost) in enumerate(edges, len(nodes)):
        edge = {"id": number, "startid": begin, "endid": end, "cost": cost}
        edge["overridable"] = drawing.weights is None  # Nav2 keeps costs of others, even if closed
        line = [[*nodes[begin][1:]], [*nodes[end][1:]]]
        place = {"type": "MultiLineString", "coordinates": [line]}
        features.append({"type": "Feature", "properties": edge, "geometry": place})
    name = _name_of(path, drawing)
    write_json(path, {"type": "FeatureCollection", "name": name, "features": features})
    return _lost(drawing, meanings)


def write_ros(path: Path, drawing: Drawing, meanings: Mapping[str, Tile]) -> list[str]:
    """Write a map of ROS, a .yaml and a .pgm of one pixel a cell: free or occupied."""
    free = free_cells(drawing.rows, meanings)
    picture, side = path.with_suffix(".pgm"), side_of(path, drawing)
    head = f"P5\n{free.shape[1]} {free.shape[0]}\n255\n".encode()
    pixels = np.where(free, 254, 0).astype(np.uint8)  # almost white, black
    write_atomically(picture, head + pixels.tobytes())
    facts = {"image": picture.name, "mode": "trinary", "resolution": side}
    facts |= {"origin": [0.0, 0.0, 0.0], "negate": 0}
    facts |= {"occupied_thresh": 0.65, "free_thresh": 0.196}
    text = "".join(f"{name}: {json.dumps(value)}\n" for name, value in facts.items())
    write_atomically(path.with_suffix(".yaml"), text.encode())
    used = {*"".join(drawing.rows)}
    names = [tile.name for symbol, tile in meanings.items() if symbol in used]
    return [f"which tile is what ({', '.join(names)}) is"]
