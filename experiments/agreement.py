"""Does our planner rank layouts as the paper's planner does? Elites of a run, judged by both.

    python -m experiments.agreement runs/laptop human.json dsage.json

Elites spread over the archive's objective, and any layout files, under our planner at low and high
effort and under priority-based search by its published and its plain rule. Every run is a row of
runs.csv and is not simulated again, so this can be stopped and started again.
"""

import sys
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, NamedTuple

import jax.numpy as jnp
import numpy as np
import tyro
from scipy.stats import rankdata

import qdenv
from experiments.correlation import Agreement, agree, correlate
from experiments.ledger import Case, Run, complete
from experiments.pieces import table
from qdenv.cli.parser import run_program
from qdenv.domains.base import make_domain
from qdenv.io.files import write_csv
from qdenv.study.options import parse_seeds
from qdenv.study.plans import name_layouts, read_plan
from qdenv.view.style import new_figure, save_figure, styled

PAPER = "published"  # the planner that the others are compared with
PLANNERS = ("low", "high", "plain", PAPER)
PARTED = 6  # layouts listed of each planner
LOOKS = {"high": ("#0072B2", "^"), "low": ("#E69F00", "o")}  # Okabe and Ito 2008


class Subject(NamedTuple):
    """A layout that is judged."""

    name: str  # of the file, or the elite's cell
    tiles: np.ndarray  # int8 [H, W]
    objective: float  # what the archive says it is worth; NaN where it comes from a file
    flowed: bool  # none of the archive's own simulations congested
    measures: np.ndarray  # float [M]


class Judged(NamedTuple):
    """What all planners say."""

    throughput: dict[str, np.ndarray]  # by planner, float [layouts, seeds]
    jams: dict[str, np.ndarray]  # by planner, how many runs of each layout congested, int [layouts]

    def flows(self, planner: str) -> np.ndarray:
        """Return which layouts never congest under a planner and the paper's, bool [layouts]."""
        return self.jams[planner] + self.jams[PAPER] == 0

    def mean(self, planner: str) -> np.ndarray:
        """Average over all runs, congested ones too, float [layouts]."""
        return self.throughput[planner].mean(axis=1)


def spread(objective: np.ndarray, count: int) -> np.ndarray:
    """Choose rows at equal steps of rank, from the worst to the best (int [count])."""
    order = np.argsort(objective, kind="stable")
    return order[np.linspace(0, len(order) - 1, min(count, len(order))).round().astype(int)]


def subjects_of(run: qdenv.RunDirectory, count: int, files: Sequence[Path]) -> Iterator[Subject]:
    """Take elites spread over the objective, and layout files of the run's domain."""
    archive, domain = run.archive, make_domain(run.config.evaluation.domain)
    columns, cells = archive.columns, archive.cells
    for row in spread(columns["objective"], count):
        flowed = not np.any(columns["congested"][row]) if "congested" in columns else True
        name = "elite " + ",".join(map(str, cells[row]))
        known = (float(columns["objective"][row]), flowed, columns["measures"][row])
        yield Subject(name, columns["repaired"][row], *known)
    for name, path in name_layouts(files).items():
        tiles = read_plan(path, domain.name).layout
        values = [axis.value(jnp.asarray(tiles), None) for axis in domain.measures if axis.value]
        yield Subject(name, tiles, np.nan, True, np.array(values, float))


def sort_out(runs: Sequence[Run], layouts: int) -> Judged:
    """Sort runs that come layout by layout, planner by planner, seed by seed."""
    shape = (layouts, len(PLANNERS), -1)
    throughput = np.array([run.throughput for run in runs]).reshape(shape)
    jams = np.array([run.congested for run in runs]).reshape(shape).sum(axis=2)
    return Judged(
        {planner: throughput[:, place] for place, planner in enumerate(PLANNERS)},
        {planner: jams[:, place] for place, planner in enumerate(PLANNERS)},
    )


def compare(subjects: Sequence[Subject], judged: Judged) -> dict[tuple[str, str], Agreement]:
    """Compare every judge with the paper's planner, over layouts that flow under both and all.

    The last judge is the paper's planner itself, one seed against the others: chance alone keeps
    that one below 1.
    """
    paper, seeds = judged.mean(PAPER), judged.throughput[PAPER]
    objective = np.array([subject.objective for subject in subjects])
    flowed = np.array([subject.flowed for subject in subjects])
    judges = {name: (judged.mean(name), paper, judged.flows(name)) for name in PLANNERS[:-1]}
    judges["objective"] = (objective, paper, flowed & judged.flows(PAPER))
    if seeds.shape[1] > 1:
        judges["itself"] = (seeds[:, 0], seeds[:, 1:].mean(axis=1), judged.flows(PAPER))
    found = {}
    for over in ("flowing", "all"):
        for name, (ours, theirs, flows) in judges.items():
            chosen = np.isfinite(ours) & (flows | (over == "all"))
            found[name, over] = agree(ours[chosen], theirs[chosen])
    return found


def print_agreements(found: dict[tuple[str, str], Agreement]) -> None:
    """Print the correlations as a markdown table."""
    head = (f"against {PAPER}", "layouts", "Spearman (95 %)", "Kendall (95 %)", "ratio")
    rows = [
        (
            name,
            f"{one.layouts} {over}",
            *("{:.3f} ({:.3f} to {:.3f})".format(*each) for each in (one.spearman, one.kendall)),
            f"{one.ratio:.4f} +- {one.ratio_error:.4f}",
        )
        for (name, over), one in found.items()
    ]
    print("\n".join(table(head, rows)))


def print_jams(subjects: Sequence[Subject], judged: Judged) -> None:
    """Print which layouts congest, and under which planners."""
    runs = judged.throughput[PAPER].shape[1]
    for place, subject in enumerate(subjects):
        jams = {planner: judged.jams[planner][place] for planner in PLANNERS}
        if any(jams.values()):
            said = ", ".join(f"{name} {jam} of {runs}" for name, jam in jams.items() if jam)
            print(f"{subject.name} congests: {said}")


def print_parting(
    subjects: Sequence[Subject], judged: Judged, planner: str, axes: Sequence[str]
) -> None:
    """Print the flowing layouts that a planner ranks most unlike the paper's, and what goes along.

    What goes along is Spearman's correlation of the difference in rank with each measure.
    """
    places = np.flatnonzero(judged.flows(planner)).tolist()
    ours, theirs = judged.mean(planner)[places], judged.mean(PAPER)[places]
    ranked, paper = rankdata(ours), rankdata(theirs)
    parting = ranked - paper
    print(f"\n{planner} and {PAPER}: where ranks part most, of {len(places)} layouts (1: worst)")
    for at in map(int, np.argsort(-np.abs(parting), kind="stable")[:PARTED]):
        subject = subjects[places[at]]
        measures = zip(axes, subject.measures, strict=True)
        said = "".join(f", {name} {value:.4g}" for name, value in measures)
        ranks = f"rank {ranked[at]:g} ({ours[at]:.3f}) against {paper[at]:g} ({theirs[at]:.3f})"
        print(f"{subject.name}: {ranks}{said}")
    for axis, name in enumerate(axes):
        values = np.array([subjects[place].measures[axis] for place in places])
        rho, low, high = correlate("spearman", parting, values)
        print(f"difference in rank with {name}: {rho:.2f} ({low:.2f} to {high:.2f})")


def write_table(
    path: Path, subjects: Sequence[Subject], judged: Judged, axes: Sequence[str]
) -> None:
    """Write a row per layout: what each planner makes of it, and how many runs congest."""
    head = ["layout", "objective", *axes, *PLANNERS, *(f"{name}_congested" for name in PLANNERS)]
    rows = []
    for place, subject in enumerate(subjects):
        means = [judged.mean(planner)[place] for planner in PLANNERS]
        numbers = [f"{number:.6g}" for number in (subject.objective, *subject.measures, *means)]
        rows.append((subject.name, *numbers, *(judged.jams[name][place] for name in PLANNERS)))
    write_csv(path, head, rows)


@styled
def draw(path: Path, subjects: Sequence[Subject], judged: Judged, title: str) -> None:
    """Draw our planner's throughput over the paper's: all layouts, and a nearer look."""
    theirs = judged.mean(PAPER)
    ours = {name: (judged.mean(name), judged.flows(name)) for name in LOOKS}
    figure = new_figure(10, 5.4)
    whole, near = figure.subplots(1, 2)
    for axes, heading in ((whole, "all layouts"), (near, "layouts that flow, from near by")):
        for name, (mean, flows) in ours.items():
            colour, marker = LOOKS[name]
            look = {"s": 26, "marker": marker, "edgecolors": colour}
            hollow = f"{name} effort, a run congests"
            axes.scatter(theirs[flows], mean[flows], c=colour, label=f"{name} effort", **look)
            axes.scatter(theirs[~flows], mean[~flows], c="none", label=hollow, **look)
        axes.axline((0, 0), slope=1, color="grey", linewidth=0.8, zorder=0)
        axes.spines[["top", "right"]].set_visible(False)
        label = "throughput under priority-based search, published rule"
        axes.set(title=heading, xlabel=label, aspect="equal")
    means = np.array([theirs, *(mean for mean, _ in ours.values())])
    end = 1.05 * means.max()
    whole.set(xlim=(0, end), ylim=(0, end), ylabel="throughput [tasks / timestep]")
    # Files are named. Below the diagonal is space: no planner is much worse than the paper's.
    files = [place for place, one in enumerate(subjects) if np.isnan(one.objective)]
    for number, place in enumerate(files, start=1):
        spot = theirs[place], means[1:, place].min()
        whole.annotate(str(number), spot, (4, -9), textcoords="offset points", fontsize=8)
    key = "\n".join(f"{number}: {subjects[at].name}" for number, at in enumerate(files, start=1))
    whole.text(0.98, 0.03, key, transform=whole.transAxes, ha="right", fontsize=8)
    shown = means[:, np.all([flows for _, flows in ours.values()], axis=0)]
    if shown.size:
        # The worst layouts lie far below the others, which they would press into a corner.
        least, most = np.quantile(shown, 0.1), shown.max()
        margin = 0.05 * (most - least) + 0.01
        near.set(xlim=(least - margin, most + margin), ylim=(least - margin, most + margin))
    handles = whole.get_legend_handles_labels()
    figure.legend(*handles, loc="outside lower center", ncols=4, frameon=False, fontsize="small")
    figure.suptitle(title, fontsize="medium")
    save_figure(figure, path)


def main(
    run: Annotated[Path, tyro.conf.Positional],
    layouts: Annotated[tuple[Path, ...], tyro.conf.Positional] = (),
    elites: int = 40,
    agents: int = 200,
    timesteps: int = 1000,
    seeds: str = "3",
    out: Path = Path("runs/agreement"),
) -> None:
    """Simulate what is missing, write runs.csv, agreement.csv and agreement.png, print tables.

    Args:
        run: folder of a run that searched layouts for fleets.
        layouts: further layout files of its domain, like hand-made ones.
        elites: how many, spread over the objective.
        agents: number of agents.
        timesteps: horizon T.
        seeds: how many seeds, or a list of them.
        out: folder of the table of runs, the table of layouts and the picture.
    """
    opened, chosen = qdenv.RunDirectory.open(run), parse_seeds(seeds)
    domain = make_domain(opened.config.evaluation.domain)
    axes = [axis.name for axis in opened.measures]
    subjects = list(subjects_of(opened, elites, layouts))
    cases = [
        Case(subject.name, subject.tiles, domain, agents, timesteps, planner)
        for subject in subjects
        for planner in PLANNERS
    ]
    runs = complete(out / "runs.csv", cases, chosen, say=partial(print, flush=True))
    judged = sort_out(runs, len(subjects))
    write_table(out / "agreement.csv", subjects, judged, axes)
    title = f"{domain.name}, {agents} agents, {timesteps} timesteps, {len(chosen)} seeds"
    draw(out / "agreement.png", subjects, judged, title)
    print_jams(subjects, judged)
    print(f"\n{title}; intervals: 95 %, bootstrap over layouts\n")
    print_agreements(compare(subjects, judged))
    for planner in ("low", "high", "plain"):
        print_parting(subjects, judged, planner, axes)
    print(", ".join(str(out / name) for name in ("runs.csv", "agreement.csv", "agreement.png")))


if __name__ == "__main__":
    sys.exit(run_program(main, "python -m experiments.agreement"))
