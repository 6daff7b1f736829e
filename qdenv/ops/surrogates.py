"""The operation on surrogates: how well one predicts the elites of a run."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from qdenv.io.files import write_csv
from qdenv.ops.options import (
    Out,
    Picture,
    Run,
    Seeds,
    SurrogateOptions,
    list_seeds,
    open_run,
)
from qdenv.ops.output import AUTO, PICTURES, format_table, place, say
from qdenv.ops.results import Facts
from qdenv.progress import Bar
from qdenv.study.options import find_surrogate
from qdenv.zoo import file_name

if TYPE_CHECKING:  # imports jax
    from qdenv.study.surrogate import Evaluated, Split


def fit_surrogate(
    run: Run,
    seeds: Seeds = 3,
    out: Out = None,
    plot: Picture = None,
    **options: Unpack[SurrogateOptions],
) -> Facts:
    """Predict a run's elites by a surrogate: how much of throughput and measures it can tell.

    The surrogate is DSAGE's. It learns from four fifths of the elites and predicts the others:
    the repaired layout from the drawn one, then throughput and measures. How much each cell is
    used is left out, as no archive has it.

    Args:
        run: folder of the run; its archive needs 50 elites or more.
        seeds: 3 for three random splits, seeds 0 to 2; 3,5,9 for these three; 7, for this one.
        out: CSV file to write, a line for each elite held out; RUN_surrogate.csv unless given.
        plot: picture to write, predicted over true; beside the table unless given.
        **options: see `SurrogateOptions`.

    Raises:
        InputError: there are too few elites, or a setting is impossible.
    """
    numbers: dict[str, Any] = {"size": "small", **options}
    config, chosen = find_surrogate(numbers.pop("size"), numbers), list_seeds(seeds)
    name = file_name(Path(str(run)))
    table = None if out is None else place(out, f"{name}_surrogate.csv", (".csv",))
    picture = table and table.beside(".png")
    if plot not in (None, AUTO):
        picture = place(plot, "surrogate.png", PICTURES)
    opened = open_run(run)
    _ = opened.archive  # refuses a folder without one
    # This imports jax: refusals are faster without it.
    from qdenv.study.surrogate import read_elites, scores_to_dict, try_surrogate

    elites = read_elites(opened)
    _, rows, cols = elites.drawn.shape
    plural, blocks = "s" * (len(chosen) > 1), "s" * (config.blocks != 1)
    say(
        f"{name}: {len(elites)} elites of {rows} x {cols}, a fifth held out, {len(chosen)} random "
        f"split{plural}; surrogate of {config.channels} channels, {config.blocks} residual "
        f"block{blocks}, {config.epochs} epochs"
    )
    with Bar("learning", total=1) as bar:
        trials = try_surrogate(elites, config, chosen, bar)
    facts = scores_to_dict(elites, config, trials)
    say(*_describe_skills(facts))
    if table:
        _write_predictions(table.path, elites, trials)
    if picture:
        _draw_predictions(picture.path, elites, trials, facts, name)
    if table or picture:
        say(", ".join(str(one) for one in (table, picture) if one))
    return Facts(facts | {"settings": {"run": str(run), "seeds": chosen}})


def _describe_skills(facts: Mapping[str, Any]) -> list[str]:
    """Put the figures in a table, with what they mean below."""
    head = ("held out", "R2 (s.d.)", "RMSE (s.d.)", "rank correlation (s.d.)")
    rows = [
        (name, _figure(one["r2"]), _figure(one["rmse"], ".3g"), _figure(one["rank"]))
        for name, one in facts["skills"].items()
    ]
    lines = format_table([head, *rows])
    lines.append(
        "R2: 1 is perfect, 0 no better than the mean of the elites held out; s.d. over the splits"
    )
    if "repaired_tiles_predicted" in facts:
        lines.append(
            f"tiles of repaired layouts predicted: {facts['repaired_tiles_predicted']['mean']:.1%}"
            f" (as drawn, without a surrogate: {facts['repaired_tiles_as_drawn']:.1%})"
        )
    return lines


def _figure(figure: Mapping[str, Any], form: str = ".2f") -> str:
    """Write a mean and its spread, as far as they are known."""
    mean, spread = figure["mean"], figure["spread"]
    if np.isnan(mean):
        return "does not vary"
    return f"{mean:{form}}" + ("" if np.isnan(spread) else f" ({spread:{form}})")


def _write_predictions(path: Path, elites: Evaluated, trials: list[Split]) -> None:
    """Write every held-out elite of every split, its true numbers and the predicted ones."""
    names = elites.names
    head = ["seed", "cell", *(f"{word}{name}" for name in names for word in ("", "predicted "))]
    lines = []
    for trial in trials:
        for row, predicted in zip(trial.held, trial.predicted, strict=True):
            pairs = zip(elites.numbers[row], predicted, strict=True)
            cell = ",".join(map(str, elites.cells[row]))
            lines.append([trial.seed, cell, *(f"{one:.6g}" for pair in pairs for one in pair)])
    write_csv(path, head, lines)


def _draw_predictions(
    path: Path, elites: Evaluated, trials: list[Split], facts: Mapping[str, Any], name: str
) -> None:
    """Draw predicted over true values, a panel for each number."""
    from qdenv.view.archive import draw_predictions  # imports matplotlib
    from qdenv.view.style import save_figure

    truth = np.concatenate([elites.numbers[trial.held] for trial in trials])
    predicted = np.concatenate([trial.predicted for trial in trials])
    panels = {}
    for number, (one, figures) in enumerate(facts["skills"].items()):
        unit = f" [{elites.units}]" if number == 0 and elites.units else ""
        text = f"R2 {_figure(figures['r2'])}, rank {_figure(figures['rank'])}"
        panels[one + unit] = (truth[:, number], predicted[:, number], text)
    many = f"{len(trials)} splits; in brackets the standard deviation over them"
    splits = many if len(trials) > 1 else "1 split"
    title = f"{name}: {facts['held_out']} of {facts['elites']} elites held out, {splits}"
    save_figure(draw_predictions(panels, title), path)
