"""The command lines of `cli` and `pages` (cli.txt), and the files in the folder of each."""

import json
from pathlib import Path

FILES = {
    "plan.txt": """\
..........
w.e@e.e..w
...e..@e..
...@ee@e..
w..e..e..w
...e......
..e@e.@e..
w..e..e..w
..........
""",
    "other.txt": """\
..........
w...e....w
...e@ee...
...eee@e..
w.e@eee..w
...ee@e...
....ee....
w.ee@e...w
..@ee.....
""",
    "broken.txt": """\
..........
w.e@e.e..w
...e..@e..
...@ee@ew.
w......e..
...e.@....
..e@e.@@..
w..e..@.ew
......@...
""",
    "factory.txt": """\
..........
..e.......
.e0e.e1e..
..e...e...
......e...
..e..e2e..
.e1e..e...
..e.......
..........
""",
    "mended.txt": """\
..........
..e.......
.e0e..1e..
..e.......
......e...
.2e..e2e..
.e1e..e...
..e....0..
..........
""",
    "maze.txt": "XXXXXXXX\nX   X  X\nX X X  X\nX X   XX\nX XXX  X\nX    X X\nXXXXXXXX\n",
    "maze.map": "type octile\nheight 4\nwidth 5\nmap\n.....\n.@@@.\n...T.\n@@...\n",
    "walls.txt": "\n".join(["!" * 10, *["!" + "?" * 8 + "!"] * 7, "!" * 10, ""]),
    "shelf.txt": "\n".join(["?" * 10] * 4 + ["?" * 4 + "@e" + "?" * 4] + ["?" * 10] * 4 + [""]),
    "ragged.txt": "...........\n...\n",
    "strange.txt": "....\n....\n.?..\n",
    "empty.txt": "",
    "thin.txt": "....\n" * 5,
    "bad.json": '{"layout": [".."',
    "shape.json": '{"layout": ["..", "."]}',
    "taken": "",
    "damaged/config.json": "{}",
    "agent/config.json": '{"steps": 100}',
    "agent/checkpoint.npz": "",
    "model.tar": "no zip",
}
FILES["plan.csv"] = "\n".join(",".join(row) for row in FILES["plan.txt"].split()) + "\n"
FILES["plan.json"] = json.dumps({"domain": "warehouse-even", "layout": FILES["plan.txt"].split()})
FILES["uneven.json"] = FILES["plan.json"].replace("even", "uneven")

_SEARCH = "--timesteps 20 --simulations 2 --evaluations 6 --no-progress"
MACROS = {
    "{SIZE}": "--rows 9 --cols 10 --shelves 6 --agents 6 --archive 0 10 5 0 1 5",
    "{SMALL}": "{SIZE} --steps 6 --hidden 4 --emitters 2 --batch 3 " + _SEARCH,
    "{WAIT}": "--effort low --planner.last-resort wait --timesteps 90 --seeds 2",  # it congests
    "{Q}": "--planner pibt --timesteps 60 --seeds 2",
}
MACROS["{SMALL}"] = MACROS["{SMALL}"].replace("{SIZE}", MACROS["{SIZE}"])
MACROS["{SIZE}"] += " " + _SEARCH
# Searches that cases read, by the names of their folders.
RUNS = {
    "run": "train quick {SMALL} --seed 0",
    "run2": "train quick {SMALL} --seed 1",
    "mazes": "train maze-quick --rows 8 --cols 8 --evaluations 200 --no-progress --batch 40 "
    "--emitters 5 --archive 0 40 40 0 30 30 --sigma0 1 --steps 6 --hidden 4 --timesteps 60",
}

_PARTS = (Path(__file__).parent / "cli.txt").read_text("utf-8").split("# ")[1:]
_CASES = {name: lines for name, *lines in (part.splitlines() for part in _PARTS)}
CHEAP = ["--version", "--help", "help repair", *_CASES["help"], *_CASES["refused"]]
COSTLY = _CASES["done"]
PAGES = _CASES["pages"]  # commands that write pages: the section `pages`
