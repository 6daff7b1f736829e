"""Figure 21: a result archive of every domain and algorithm."""

from experiments.archives import ALGORITHMS, RUNS, draw_archive, note, read_all, scale_of
from experiments.pieces import Drawn, Experiment, Folders
from qdenv.view.style import new_figure


def draw(folders: Folders) -> Drawn:
    """Draw the archives that are saved, a line and a colour scale per domain."""
    found = read_all(folders)
    figure = new_figure(3.4 * len(ALGORITHMS), 3.1 * len(found), dpi=100)
    panels = figure.subplots(len(found), len(ALGORITHMS), squeeze=False)
    for (domain, runs), line in zip(found.items(), panels, strict=True):
        first = {name: own[0] for name, own in runs.items()}
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
