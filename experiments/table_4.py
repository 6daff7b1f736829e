"""Table 4: QD-score and coverage of CMA-MAE, MAP-Elites and DSAGE, beside the paper's."""

import numpy as np

from experiments.archives import ALGORITHMS, DOMAINS, runs_of, seeds_of
from experiments.pieces import Drawn, Experiment, Folders, table
from experiments.published import TABLE_4
from qdenv.stats import sample_of

HEAD = [
    *("domain", "algorithm", "runs", "evaluations", "QD-score", "coverage"),
    *("best objective", "paper: QD-score, coverage", "ours / paper's"),
]


def spread(values: list[float], form: str) -> str:
    """Write a mean with its standard error, where there is one."""
    sample = sample_of(np.array(values))
    error = "" if np.isnan(sample.error) else f" ± {sample.error:{form}}"
    return f"{sample.mean:{form}}{error}"


def draw(folders: Folders) -> Drawn:
    """Average the final metrics of the runs that are saved."""
    rows: list[tuple[object, ...]] = []
    for domain in DOMAINS:
        for algorithm in ALGORITHMS:
            paper = TABLE_4.get((domain, algorithm))
            last = [
                one.last for run in runs_of(domain, algorithm) for one in seeds_of(run, folders)
            ]
            if not last:
                if paper:
                    rows.append((domain, algorithm, 0, *["not run"] * 4, paper, ""))
                continue
            made = sorted({f"{one.evaluations:,}" for one in last})
            rows.append(
                (
                    *(domain, algorithm, len(last), ", ".join(made)),
                    spread([one.qd_score for one in last], ",.0f"),
                    spread([one.coverage for one in last], ".3f"),
                    spread([one.best_objective for one in last], ".3f"),
                    paper or "",
                    f"{np.mean([one.qd_score for one in last]) / paper.qd_score:.2f}"
                    if paper
                    else "",
                )
            )
    return Drawn(None, table(HEAD, rows))


RUNS = tuple(run for domain in DOMAINS for name in ALGORITHMS for run in runs_of(domain, name))
EXPERIMENT = Experiment("QD-score and coverage of all algorithms", RUNS, draw)
