"""Make the layouts of this folder anew: `python tests/data/layouts/make_layouts.py`.

Random automata of one key draw layouts of 33 x 36; the one with a smooth traffic of 24 was chosen
by hand for each domain, and repaired to the solver's proof or limits. The hand-made ones are what
`qdenv layout human` draws. On another machine the last bits of a convolution may differ, and with
them a tile: the tests measure the files as they are.
"""

import sys
import tempfile
from pathlib import Path

from experiments.benchmarks.repair import KERNELS, grow_random
from qdenv.cli import main as cli
from qdenv.domains.base import find_domain
from qdenv.io.layouts import write_layout

FOLDER = Path(__file__).parent
DRAWN = 24  # layouts of each key
# name -> (domain, key, which of the layouts drawn, options of its repair)
GROWN = {
    "warehouse_even": ("warehouse-even", 7, 1, ("--shelves", "240")),
    "warehouse_uneven": ("warehouse-uneven", 8, 2, ("--shelves", "240")),
    "manufacturing": ("manufacturing", 7, 15, ()),
}
# name -> (domain, rows, columns)
HUMAN = {
    "warehouse_human": ("warehouse-even", 33, 36),
    "manufacturing_human_57x58": ("manufacturing", 57, 58),
}


def command(*arguments: str) -> None:
    """Run one command of `qdenv`; stop where it fails."""
    if code := cli.run(list(arguments)):
        sys.exit(code)


def main() -> None:
    """Write every layout of this folder."""
    for name, (kind, key, index, options) in GROWN.items():
        unrepaired, repaired = FOLDER / f"{name}_unrepaired.json", FOLDER / f"{name}.json"
        layout = grow_random(kind, DRAWN, KERNELS, key)[index]
        details = {"domain": kind, "key": key, "index": index, "kernel_sizes": KERNELS}
        write_layout(unrepaired, layout, find_domain(kind).tiles, **details)
        command("repair", str(unrepaired), "--domain", kind, *options, "--out", str(repaired))
    with tempfile.TemporaryDirectory() as place:
        for name, (kind, rows, cols) in HUMAN.items():
            drawn = Path(place) / f"{name}.json"
            size = ("--rows", str(rows), "--cols", str(cols))
            command("layout", "human", *size, "--domain", kind, "--out", str(drawn))
            (FOLDER / drawn.name).write_text(drawn.read_text())


if __name__ == "__main__":
    main()
