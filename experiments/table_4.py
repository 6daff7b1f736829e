"""Table 4: QD-score and coverage of CMA-MAE, MAP-Elites and DSAGE, beside the paper's."""

from itertools import product

import numpy as np

from experiments.archives import ALGORITHMS, DOMAINS, RUNS, read_all
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
    found = read_all(folders)
    for domain, algorithm in product(DOMAINS, ALGORITHMS):
        paper = TABLE_4.get((domain, algorithm))
        last = [one.last for one in found.get(domain, {}).get(algorithm, [])]
        if last:
            made = sorted({f"{one.evaluations:,}" for one in last})
            scores = [one.qd_score for one in last]
            ratio = f"{np.mean(scores) / paper.qd_score:.2f}" if paper else ""
            numbers = (
                spread(scores, ",.0f"),
                spread([one.coverage for one in last], ".3f"),
                spread([one.best_objective for one in last], ".3f"),
            )
            runs = (domain, algorithm, len(last), ", ".join(made))
            rows.append((*runs, *numbers, paper or "", ratio))
        elif paper:
            rows.append((domain, algorithm, 0, *["not run"] * 4, paper, ""))
    return Drawn(None, table(HEAD, rows))


EXPERIMENT = Experiment("QD-score and coverage of all algorithms", RUNS, draw)
