"""Pictures of judges: what several say of layouts over what one says of them."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes

from qdenv.view.style import new_figure, save_figure, styled

LOOKS = (("#0072B2", "^"), ("#E69F00", "o"), ("#009E73", "s"), ("#CC79A7", "D"))  # Okabe, Ito 2008


class Opinion(NamedTuple):
    """What one judge says of layouts."""

    throughput: np.ndarray  # float [layouts]
    flows: np.ndarray  # bool [layouts], no run of either judge congested


@styled
def save_agreement(
    path: Path,
    theirs: np.ndarray,
    opinions: Mapping[str, Opinion],
    names: Mapping[int, str],
    title: str,
    label: str,
) -> None:
    """Draw the throughput by several judges over that by one: all layouts, and a nearer look.

    Args:
        path: the picture.
        theirs: float [layouts], along the horizontal axis.
        opinions: by judge, along the vertical axis.
        names: of layouts that are named in the picture, by their place.
        title: of the picture.
        label: of the horizontal axis.

    Raises:
        InputError: the place cannot be written to.
    """
    figure = new_figure(10, 5.4)
    whole, near = figure.subplots(1, 2)
    flows = np.all([opinion.flows for opinion in opinions.values()], axis=0)
    shown = [theirs[flows], *(opinion.throughput[flows] for opinion in opinions.values())]
    for axes, heading in ((whole, "all layouts"), (near, "layouts that flow, from near by")):
        _scatter(axes, theirs, opinions)
        axes.set(title=heading, xlabel=label, aspect="equal")
    end = 1.05 * max(theirs.max(), *(opinion.throughput.max() for opinion in opinions.values()))
    whole.set(xlim=(0, end), ylim=(0, end), ylabel="throughput [tasks / timestep]")
    lowest = np.min([opinion.throughput for opinion in opinions.values()], axis=0)
    for number, place in enumerate(names, start=1):
        spot = (theirs[place], lowest[place])
        whole.annotate(str(number), spot, (4, -9), textcoords="offset points", fontsize=8)
    # Below the diagonal is room: nobody drives much worse than the judge along it.
    key = "\n".join(f"{number}: {name}" for number, name in enumerate(names.values(), start=1))
    whole.text(0.98, 0.03, key, transform=whole.transAxes, ha="right", fontsize=8)
    if flows.any():
        # The worst layouts lie far below the others, which they would press into a corner.
        least, most = np.quantile(shown, 0.1), np.max(shown)
        margin = 0.05 * (most - least) + 0.01
        near.set(xlim=(least - margin, most + margin), ylim=(least - margin, most + margin))
    handles = whole.get_legend_handles_labels()
    figure.legend(*handles, loc="outside lower center", ncols=4, frameon=False, fontsize="small")
    figure.suptitle(title, fontsize="medium")
    save_figure(figure, path)


def _scatter(axes: Axes, theirs: np.ndarray, opinions: Mapping[str, Opinion]) -> None:
    """Draw a point per judge and layout, hollow where a run congests, and the diagonal."""
    for (name, opinion), (colour, marker) in zip(opinions.items(), LOOKS, strict=False):
        for chosen, face, label in (
            (opinion.flows, colour, name),
            (~opinion.flows, "none", f"{name}, a run congests"),
        ):
            spots = theirs[chosen], opinion.throughput[chosen]
            axes.scatter(*spots, s=26, c=face, marker=marker, edgecolors=colour, label=label)
    axes.axline((0, 0), slope=1, color="grey", linewidth=0.8, zorder=0)
    axes.spines[["top", "right"]].set_visible(False)
