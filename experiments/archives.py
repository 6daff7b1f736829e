"""The runs of Table 4 and Figures 20 and 21; archives as heat maps."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

from matplotlib.axes import Axes
from matplotlib.image import AxesImage

from experiments.pieces import Folders
from experiments.runs import Summary, run_of
from qdenv.view.archive import draw_heatmap

DOMAINS = ("warehouse-even", "warehouse-uneven", "manufacturing", "maze-walls", "maze-entropy")
# Colours (Okabe and Ito 2008) and styles, which grey prints tell apart, too.
ALGORITHMS = {
    "cma-mae": ("#0072B2", "-"),
    "map-elites": ("#D55E00", "--"),
    "cma-es": ("#E69F00", "-."),
    "dsage": ("#CC79A7", ":"),
}
# By domain and algorithm, of seed 0.
ROWS = {
    (domain, name): run_of(domain, "" if name == "cma-mae" else name)
    for domain, name in product(DOMAINS, ALGORITHMS)
    if name != "cma-es" or not domain.startswith("maze")
}
RUNS = tuple(ROWS.values())


def read_all(folders: Folders) -> dict[str, dict[str, list[Summary]]]:
    """Read the saved runs, further seeds as well, by domain and algorithm, as far as there are."""
    found: dict[str, dict[str, list[Summary]]] = {}
    for ((domain, name), run), seed in product(ROWS.items(), range(5)):
        if (one := replace(run, seed=seed).read(folders)) is not None:
            found.setdefault(domain, {}).setdefault(name, []).append(one)
    return found


def draw_archive(axes: Axes, summary: Summary, title: str, scale: tuple[float, float]) -> AxesImage:
    """Draw an archive on a colour scale that several share."""
    image = draw_heatmap(axes, summary.objectives, summary.measures, *scale)
    axes.set_title(f"{title}\n{len(summary.elites['cell']):,} elites", fontsize="small")
    return image


def note(axes: Axes, text: str) -> None:
    """Write in place of a picture why there is none."""
    axes.text(0.5, 0.5, text, ha="center", va="center", color="dimgray")
    axes.set_axis_off()


def scale_of(summaries: Sequence[Summary]) -> tuple[float, float]:
    """Find the least and the greatest objective of several archives."""
    values = [value for one in summaries for value in one.elites["objective"]]
    return float(min(values)), float(max(values))
