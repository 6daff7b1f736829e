"""Grow one elite to the sizes of Figure 18 and climb to the peak of each layout and its baselines.

    python experiments/sizes.py runs/manufacturing --timesteps 1000 --seeds 3

At each size: the elite's layout, the one people design, and the elite's smallest layout tiled
(section E.4). The paper uses 50 runs of 5,000 timesteps.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro

from qdenv.domains.base import make_domain
from qdenv.formats.layouts import write_layout
from qdenv.plots.studies import save_peaks
from qdenv.simulate.mapf.fleet import FleetConfig
from qdenv.simulate.mapf.negotiated.settings import EFFORTS
from qdenv.study import sizes
from qdenv.study.options import parse_seeds
from qdenv.study.sweep import Trial, climb
from qdenv.study.table import find_peak, write_rows
from qdenv.training.records import RunDirectory

# Throughput and success rate, T = 5000: S with 200 agents; S_eval with 1,400, 1,000 and 1,800.
PUBLISHED = {
    "warehouse-even": "S: ours 6.74, human congests; S_eval: ours 16.01 (90 %), tiled 0 %",
    "warehouse-uneven": "S: ours 6.82, human congests; S_eval: ours 12.03 (84 %), tiled 23 %",
    "manufacturing": "S: ours 6.82, human 5.92; S_eval: ours 23.11 (100 %), tiled 22.73 (100 %)",
}
STEP = 50 / (33 * 36)  # agents per cell from one number to the next


def layouts_of(
    run: RunDirectory, elite: str, shapes: list[tuple[int, int]]
) -> Iterator[tuple[str, np.ndarray]]:
    """Make the elite's layout, the hand-made and the tiled one of each size, by name."""
    domain = make_domain(run.config.evaluation.domain)
    small = None
    for grown in sizes.grow_sizes(run, elite, shapes):
        shape = grown.layout.shape
        yield "nca", grown.layout
        yield "human", sizes.human_layout(domain.resized(*shape))
        if small is not None:
            yield "tiled", sizes.tile(domain, small, shape).layout
        small = grown.layout if small is None else small


def main(
    run_dir: tyro.conf.Positional[Path],
    elite: str = "best",
    asked: Annotated[tuple[str, ...], tyro.conf.arg(name="sizes")] = tuple(
        f"{rows}x{cols}" for rows, cols in sizes.SIZES
    ),
    timesteps: int = 1000,
    seeds: tuple[int, ...] = (3,),
    effort: Literal["low", "high"] = "high",
    out: Path = Path("sizes"),
) -> None:
    """Write every layout, scalability.csv and scalability.png, and print the peaks.

    Args:
        run_dir: the run directory.
        elite: "best", or the archive cell's indices like 12,40.
        asked: rows and columns of each size.
        timesteps: how long to simulate.
        seeds: how many seeds, or a list of them.
        effort: low for a quick look, high for numbers to report.
        out: folder to write to.
    """
    run = RunDirectory.open(run_dir)
    domain = make_domain(run.config.evaluation.domain)
    config = FleetConfig(timesteps=timesteps, planner=EFFORTS[effort])
    rows, peaks = [], []
    for kind, layout in layouts_of(run, elite, [sizes.parse_size(size) for size in asked]):
        name = f"{kind}_{layout.shape[0]}x{layout.shape[1]}"
        write_layout(out / f"{name}.json", layout, domain.tiles, domain=domain.name)
        step = max(1, round(STEP * layout.size))
        counts = range(step, layout.size, step)
        rows += climb(
            name, layout, Trial(domain.simulator.tasks, config, counts, parse_seeds(seeds))
        )
        peaks.append(find_peak([row for row in rows if row.layout == name]))
        print(f"{name}: peak {peaks[-1].throughput:.3f} at {peaks[-1].agents} agents", flush=True)
    write_rows(out / "scalability.csv", rows)
    save_peaks(out / "scalability.png", rows, peaks)
    print(f"paper: {PUBLISHED.get(domain.name, 'no figures')}")


if __name__ == "__main__":
    tyro.cli(main)
