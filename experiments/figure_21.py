"""Figure 21: a result archive of every domain and algorithm."""

from experiments.archives import (
    ALGORITHMS,
    DOMAINS,
    draw_archive,
    note,
    runs_of,
    scale_of,
    seeds_of,
)
from experiments.pieces import Drawn, Experiment, Folders
from experiments.table_4 import RUNS
from qdenv.view.style import new_figure


def draw(folders: Folders) -> Drawn:
    """Draw the archives that are saved, a line and a colour scale per domain."""
    found = {
        (domain, name): [one for run in runs_of(domain, name) for one in seeds_of(run, folders)]
        for domain in DOMAINS
        for name in ALGORITHMS
    }
    domains = [domain for domain in DOMAINS if any(found[domain, name] for name in ALGORITHMS)]
    figure = new_figure(3.4 * len(ALGORITHMS), 3.1 * len(domains), dpi=100)
    panels = figure.subplots(len(domains), len(ALGORITHMS), squeeze=False)
    for domain, line in zip(domains, panels, strict=True):
        first = {name: found[domain, name][0] for name in ALGORITHMS if found[domain, name]}
        scale = scale_of(list(first.values()))
        for name, axes in zip(ALGORITHMS, line, strict=True):
            if name not in first:
                note(axes, f"{domain}\n{name}\nnot run yet")
                continue
            one = first[name]
            title = f"{domain}, {name}, {one.last.evaluations:,} evaluations"
            image = draw_archive(axes, one, title, scale)
        figure.colorbar(image, ax=line, shrink=0.8)
    return Drawn(figure)


EXPERIMENT = Experiment("archives of all domains and algorithms", RUNS, draw)
