"""What an algorithm says of itself over evaluations: losses and errors of a surrogate."""

from pathlib import Path

from qdenv.plots.figure import new_figure, save_figure
from qdenv.run.log import Note

UNSAID = ("iteration", "evaluations", "fits")  # what a curve would tell nobody
LOGARITHMIC = ("loss", "rmse")  # what shrinks by factors
LOWEST_R2 = -1.0  # further down it says no more than "bad"
COLUMNS = 4


def save_notes(path: Path, notes: list[Note]) -> None:
    """Draw one panel for each kind of number: ``loss_repair`` and ``loss_usage`` are of one kind.

    Args:
        path: picture to write.
        notes: one per iteration, at least one.
    """
    kinds: dict[str, list[str]] = {}
    for name in notes[0]:
        if name not in UNSAID:
            kinds.setdefault(name.partition("_")[0], []).append(name)
    rows = -(-len(kinds) // COLUMNS)
    figure = new_figure(10, 3.4 * rows, dpi=120)
    panels = figure.subplots(rows, COLUMNS, squeeze=False).ravel()
    evaluations = [note["evaluations"] for note in notes]
    for axes, (kind, names) in zip(panels, kinds.items(), strict=False):
        for name in names:
            label = name.removeprefix(f"{kind}_").replace("_", " ")
            axes.plot(evaluations, [note[name] for note in notes], ".-", label=label, lw=1)
        axes.set(title=kind if len(names) > 1 else names[0].replace("_", " "))
        axes.set_xlabel("true evaluations")
        if kind in LOGARITHMIC:
            axes.set_yscale("log")
        if kind == "r2":
            axes.set_ylim(LOWEST_R2, 1)
        if len(names) > 1:
            # Below the panel: inside, it would cover the curves.
            place = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.2), "ncols": 2}
            axes.legend(fontsize="x-small", frameon=False, **place)
        axes.spines[["top", "right"]].set_visible(False)
    for axes in panels[len(kinds) :]:
        axes.set_visible(False)
    save_figure(figure, path)
