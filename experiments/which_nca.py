"""Which automaton and which strategy search better at equal evaluations?

    python experiments/which_nca.py --preset quick --seeds 3

Compares kernels (3,3,3) of the appendix with (3,1,1) of the published code, and the isotropic
with the separable evolution strategy. Finished runs are kept, so it can be stopped and continued.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from dataclasses import replace
from pathlib import Path

import numpy as np
import tyro

import qdenv

KERNELS = ((3, 3, 3), (3, 1, 1))
STRATEGIES = ("iso", "sep")


def main(preset: str = "quick", seeds: int = 3, out: Path = Path("runs/which_nca")) -> None:
    """Run all combinations and print mean and standard error of their final metrics.

    Args:
        preset: the configuration they share.
        seeds: runs per combination.
        out: folder of the runs.
    """
    base = qdenv.find_preset(preset)
    print(f"{preset}, {base.evaluations} evaluations, {seeds} seeds: mean (standard error)")
    print("kernels   strategy  QD-score          coverage          best objective")
    for kernels in KERNELS:
        for strategy in STRATEGIES:
            finals = []
            for seed in range(seeds):
                path = out / f"{preset}-{''.join(map(str, kernels))}-{strategy}-{seed}"
                config = replace(
                    base,
                    seed=seed,
                    evaluation=replace(base.evaluation, kernel_sizes=kernels),
                    algorithm=replace(base.algorithm, strategy=strategy),
                )
                new = not (path / "config.json").exists()
                run = qdenv.train(config, path) if new else qdenv.resume(path)
                last = run.read_metrics()[-1]
                finals.append([last.qd_score, last.coverage, last.best_objective])
            mean = np.mean(finals, axis=0)
            error = np.std(finals, axis=0, ddof=1) / np.sqrt(seeds) if seeds > 1 else mean * np.nan
            cells = [f"{m:.3f} ({e:.3f})" for m, e in zip(mean, error, strict=True)]
            print(f"{kernels!s:9} {strategy:8}  " + "".join(f"{cell:18}" for cell in cells))


if __name__ == "__main__":
    tyro.cli(main)
