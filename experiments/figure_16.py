"""Figure 16: result archives of warehouses over alpha, on one colour scale."""

from experiments.archives import draw_archive, note, scale_of
from experiments.pieces import Drawn, Experiment, Folders, table
from experiments.runs import SavedRun
from qdenv.view.style import new_figure

ALPHAS = {0: "-a0", 1: "-a1", 5: ""}
DOMAINS = ("warehouse-even", "warehouse-uneven")
RUNS = {
    (domain, alpha): SavedRun(f"{domain}{ending}")
    for domain in DOMAINS
    for alpha, ending in ALPHAS.items()
}
REGULAR = 0.5  # entropy below which patterns are clear
NOTE = "One run each, seed 0, under low effort of our planner."
HEAD = ("domain", "alpha", "evaluations", "elites", f"entropy below {REGULAR}", "QD-score")


def draw(folders: Folders) -> Drawn:
    """Draw the archives that are saved and count their regular elites."""
    found = {key: one for key, run in RUNS.items() if (one := run.read(folders)) is not None}
    domains = [domain for domain in DOMAINS if any(domain == key[0] for key in found)]
    figure = new_figure(11, 3.8 * len(domains), dpi=100)
    panels = figure.subplots(len(domains), len(ALPHAS), squeeze=False)
    scale, rows = scale_of(list(found.values())), []
    for domain, line in zip(domains, panels, strict=True):
        for alpha, axes in zip(ALPHAS, line, strict=True):
            one = found.get((domain, alpha))
            if one is None:
                note(axes, f"{domain}, alpha = {alpha}\nnot run yet")
                continue
            image = draw_archive(axes, one, f"{domain}, alpha = {alpha}", scale)
            regular = int((one.elites["environment entropy"] < REGULAR).sum())
            row = (domain, alpha, f"{one.last.evaluations:,}", f"{len(one.elites['cell']):,}")
            rows.append((*row, f"{regular:,}", f"{one.last.qd_score:,.0f}"))
    figure.colorbar(image, ax=panels, label="tasks / timestep", shrink=0.6)
    return Drawn(figure, (*table(HEAD, rows), "", NOTE))


EXPERIMENT = Experiment("archives of warehouses over alpha", tuple(RUNS.values()), draw)
