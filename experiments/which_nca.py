"""Which automaton and which strategy search better at equal evaluations?

    python -m experiments.which_nca --preset quick --seeds 3

Compares kernels (3,3,3) of the appendix with (3,1,1) of the published code, and the isotropic
with the separable evolution strategy. Finished runs are kept, so it can be stopped and continued.
"""

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np

import qdenv
from experiments.program import run_program
from experiments.runs import whole_run
from qdenv.ranges import PositiveInt
from qdenv.run.config import override
from qdenv.stats import standard_error

KERNELS = ((3, 3, 3), (3, 1, 1))


def main(
    preset: str = "quick",
    seeds: PositiveInt = 3,
    evaluations: PositiveInt | None = None,
    strategies: tuple[str, ...] = ("iso", "sep"),
    out: Path = Path("runs/which_nca"),
) -> None:
    """Run all combinations and print mean and standard error of their final metrics.

    Args:
        preset: the configuration they share.
        seeds: runs per combination.
        evaluations: compare after so many; as many as the preset has unless given.
        strategies: evolution strategies to compare.
        out: folder of the runs.
    """
    base = qdenv.find_preset(preset)
    evaluations = evaluations or base.evaluations
    base = replace(base, evaluations=evaluations)
    configs = {
        (kernels, strategy): override(base, {"kernel_sizes": kernels, "strategy": strategy})
        for kernels, strategy in itertools.product(KERNELS, strategies)
    }
    print(f"{preset}, {evaluations} evaluations, {seeds} seeds: mean (standard error)")
    print("kernels   strategy  QD-score          coverage          best objective")
    for (kernels, strategy), config in configs.items():
        finals = []
        for seed in range(seeds):
            path = out / f"{preset}-{''.join(map(str, kernels))}-{strategy}-{seed}"
            metrics = whole_run(replace(config, seed=seed), path).read_metrics()
            last = next(row for row in metrics if row.evaluations >= evaluations)
            finals.append([last.qd_score, last.coverage, last.best_objective])
        mean, error = np.mean(finals, axis=0), standard_error(finals)
        cells = [f"{m:.3f} ({e:.3f})" for m, e in zip(mean, error, strict=True)]
        print(f"{kernels!s:9} {strategy:8}  " + "".join(f"{cell:18}" for cell in cells))


if __name__ == "__main__":
    run_program(main, "python -m experiments.which_nca")
