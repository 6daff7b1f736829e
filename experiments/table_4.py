"""Table 4: QD-score and coverage of CMA-MAE, MAP-Elites, CMA-ES and DSAGE, beside the paper's."""

from itertools import product

import numpy as np

import qdenv
from experiments.archives import ALGORITHMS, DOMAINS, RUNS, read_all
from experiments.pieces import Drawn, Experiment, Folders, table
from experiments.published import TABLE_4
from qdenv.stats import sample_of

HEAD = [
    *("domain", "algorithm", "runs", "evaluations", "QD-score", "coverage"),
    *("best objective", "paper: QD-score, coverage", "ours / paper's"),
]
NOTE = (
    "Fleets under low effort of our planner. DSAGE: a small surrogate, 5 epochs and 500 inner "
    "iterations (paper: 10,000). No ratio where the paper has more evaluations."
)
FORMS = {"qd_score": ",.0f", "coverage": ".4f", "best_objective": ".3f"}


def draw(folders: Folders) -> Drawn:
    """Average the final metrics of the runs that are saved."""
    rows: list[tuple[object, ...]] = []
    found = read_all(folders)
    for domain, algorithm in product(DOMAINS, ALGORITHMS):
        paper = TABLE_4.get((domain, algorithm))
        last = [one.last for one in found.get(domain, {}).get(algorithm, [])]
        if last:
            made = sorted({f"{one.evaluations:,}" for one in last})
            cells: list[object] = [domain, algorithm, len(last), ", ".join(made)]
            for name, form in FORMS.items():
                mean, error, _ = sample_of(np.array([getattr(one, name) for one in last]))
                cells.append(f"{mean:{form}}" + (f" ± {error:{form}}" if len(last) > 1 else ""))
            score = np.mean([one.qd_score for one in last])
            full = min(one.evaluations for one in last) >= qdenv.find_preset(domain).evaluations
            ratio = f"{score / paper.qd_score:.2f}" if paper and full else ""
            rows.append((*cells, paper or "", ratio))
        elif paper:
            rows.append((domain, algorithm, 0, *["not run"] * 4, paper, ""))
    return Drawn(None, (*table(HEAD, rows), "", NOTE))


EXPERIMENT = Experiment("QD-score and coverage of all algorithms", RUNS, draw)
