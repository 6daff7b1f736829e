"""Search warehouse generators and put QD-score and coverage beside the paper's Table 4.

    python experiments/warehouse.py --preset warehouse-even --run-dir runs/warehouse-even

A run that exists is continued; `--evaluations` shortens it.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from dataclasses import replace
from pathlib import Path

import tyro

import qdenv

# QD-score and coverage after 10,000 evaluations, mean over 5 runs, standard error in brackets.
TABLE_4 = {
    "warehouse-even": "20366 (653), 0.33 (0.01)",
    "warehouse-uneven": "19985 (494), 0.33 (0.01)",
    "manufacturing": "6450 (1107), 0.18 (0.02)",
}


def main(
    preset: str = "warehouse-even", run_dir: Path | None = None, evaluations: int | None = None
) -> None:
    """Run or continue the search, draw its archive, print its row of Table 4.

    Args:
        preset: one of the paper's rows.
        run_dir: folder of the run.
        evaluations: fewer than the paper's 10,000.
    """
    path = run_dir or Path("runs") / preset
    if (path / "config.json").exists():
        run = qdenv.resume(path, evaluations=evaluations)
    else:
        config = qdenv.find_preset(preset)
        total = config.evaluations if evaluations is None else evaluations
        run = qdenv.train(replace(config, evaluations=total), path)
    last = run.read_metrics()[-1]
    print(f"{preset}: QD-score and coverage after {last.evaluations} evaluations")
    print(f"  ours  {last.qd_score:.0f}, {last.coverage:.3f}")
    print(f"  paper {TABLE_4.get(preset, 'no row')} after 10,000")
    for picture in qdenv.plot_run(run):
        print(f"  {picture}")


if __name__ == "__main__":
    tyro.cli(main)
