"""The command surrogate: how well a network would predict what simulations said of a run."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import tyro

from qdenv.commands import output, words
from qdenv.commands.choices import RunFolder
from qdenv.io.files import write_csv
from qdenv.progress import Bar
from qdenv.run.directory import RunDirectory
from qdenv.study.options import find_surrogate, parse_seeds
from qdenv.study.surrogate import Evaluated, read_elites
from qdenv.surrogate.settings import SurrogateConfig
from qdenv.zoo import file_name

if TYPE_CHECKING:  # imports jax
    from qdenv.study.surrogate import Trial


@dataclasses.dataclass(frozen=True)
class Learning:
    """How large the surrogate is and how it learns."""

    # small suits a CPU, published is the paper's, for a GPU; what follows replaces single numbers
    # of it
    size: Literal["small", "published"] = "small"
    channels: int | None = None  # hidden channels of its networks, 16 or 64
    # residual blocks of the network that predicts repaired layouts, 1 or 2
    blocks: int | None = None
    # how often each network sees all elites it learns from, 20 unless given
    epochs: int | None = None
    minibatch: int | None = None  # elites per step of learning, 64 unless given
    rate: float | None = None  # learning rate of Adam, 0.001 unless given

    @property
    def config(self) -> SurrogateConfig:
        """The surrogate's settings; `InputError` where a number learns nothing."""
        stated = dataclasses.asdict(self)
        return find_surrogate(stated.pop("size"), stated)


def surrogate(
    run_dir: RunFolder,
    seeds: tuple[str, ...] = ("3",),
    learning: Annotated[Learning, tyro.conf.arg(name="")] = Learning(),
    out: Path | None = None,
    plot: words.Picture = None,
    json_file: output.JsonFile = None,
) -> None:
    """Predict a run's elites by a surrogate: how much of throughput and measures it can tell.

    The surrogate is DSAGE's. It learns from four fifths of the elites and predicts the others:
    the repaired layout from the drawn one, then throughput and measures. How much each cell is
    used is left out, no archive keeps it.

    Args:
        run_dir: folder of the run; its archive needs 50 elites or more.
        seeds: 3 for three random splits, seeds 0 to 2; 3,5,9 for these three; 7, for this one.
        learning: the surrogate.
        out: CSV file to write, a line for each elite held out; RUN_surrogate.csv unless given.
        plot: picture to write, predicted over true; beside the table unless given.
        json_file: where to write the figures; - is standard output.
    """
    config, chosen = learning.config, parse_seeds(seeds)
    name = file_name(run_dir)
    table = output.place(out, f"{name}_surrogate.csv", (".csv",))
    picture = table.beside(".png")
    if plot not in (None, words.AUTO):
        picture = output.place(plot, "surrogate.png", output.PICTURES)
    elites = read_elites(RunDirectory.open(run_dir))
    # Only now: imports jax, and who is refused need not wait.
    from qdenv.study.surrogate import facts_of, try_surrogate

    print(describe(name, elites, config, len(chosen)), flush=True)
    with Bar("learning", total=1) as bar:
        trials = try_surrogate(elites, config, chosen, bar)
    facts = facts_of(elites, config, trials)
    print("\n".join(list_skills(facts)))
    write_table(table.path, elites, trials)
    draw(picture.path, elites, trials, facts, name)
    print(f"{table}, {picture}")
    output.write_facts(json_file, "surrogate", facts, run=run_dir, seeds=chosen)


def describe(name: str, elites: Evaluated, config: SurrogateConfig, splits: int) -> str:
    """Say in one line what learns from what."""
    _, rows, cols = elites.drawn.shape
    return (
        f"{name}: {len(elites)} elites of {rows} x {cols}, a fifth held out, {splits} random "
        f"split{'s' if splits > 1 else ''}; surrogate of {config.channels} channels, "
        f"{config.blocks} residual block{'s' if config.blocks != 1 else ''}, "
        f"{config.epochs} epochs"
    )


def list_skills(facts: dict[str, Any]) -> list[str]:
    """Put the figures in a table, with what they mean below."""
    skills = facts["skills"]
    width = max(map(len, skills))
    lines = [f"{'held out':{width}}  R2 (s.d.)        RMSE (s.d.)      rank correlation (s.d.)"]
    for name, figures in skills.items():
        r2, rmse, rank = in_words(figures["r2"]), in_words(figures["rmse"], ".3g"), figures["rank"]
        lines.append(f"{name:{width}}  {r2:15}  {rmse:15}  {in_words(rank)}")
    lines.append(
        "R2: 1 is perfect, 0 no better than the mean of the elites held out; s.d. over the splits"
    )
    if "repaired_tiles_predicted" in facts:
        lines.append(
            f"tiles of repaired layouts predicted: {facts['repaired_tiles_predicted']['mean']:.1%}"
            f" (as drawn, without a surrogate: {facts['repaired_tiles_as_drawn']:.1%})"
        )
    return lines


def in_words(figure: dict[str, Any], form: str = ".2f") -> str:
    """Write a mean and its spread, as far as they are known, with so many digits."""
    mean, spread = figure["mean"], figure["spread"]
    if np.isnan(mean):
        return "does not vary"
    return f"{mean:{form}}" + ("" if np.isnan(spread) else f" ({spread:{form}})")


def write_table(path: Path, elites: Evaluated, trials: list[Trial]) -> None:
    """Write every held-out elite of every split, what is true of it and what was predicted."""
    names = elites.names
    head = ["seed", "cell", *(f"{word}{name}" for name in names for word in ("", "predicted "))]
    lines = []
    for trial in trials:
        for row, predicted in zip(trial.held, trial.predicted, strict=True):
            pairs = zip(elites.numbers[row], predicted, strict=True)
            cell = ",".join(map(str, elites.cells[row]))
            lines.append([trial.seed, cell, *(f"{one:.6g}" for pair in pairs for one in pair)])
    write_csv(path, head, lines)


def draw(
    path: Path, elites: Evaluated, trials: list[Trial], facts: dict[str, Any], name: str
) -> None:
    """Draw predicted over true values, a panel for each number."""
    from qdenv.view.archive import draw_predictions  # here: imports matplotlib
    from qdenv.view.style import save_figure

    truth = np.concatenate([elites.numbers[trial.held] for trial in trials])
    predicted = np.concatenate([trial.predicted for trial in trials])
    panels = {}
    for number, (one, figures) in enumerate(facts["skills"].items()):
        unit = f" [{elites.units}]" if number == 0 and elites.units else ""
        said = f"R2 {in_words(figures['r2'])}, rank {in_words(figures['rank'])}"
        panels[one + unit] = (truth[:, number], predicted[:, number], said)
    many = f"{len(trials)} splits; in brackets the standard deviation over them"
    splits = many if len(trials) > 1 else "1 split"
    title = f"{name}: {facts['held_out']} of {facts['elites']} elites held out, {splits}"
    save_figure(draw_predictions(panels, title), path)
