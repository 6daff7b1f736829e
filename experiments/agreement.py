"""Does our planner rank layouts as the paper's planner does? Elites of a run, judged by both.

    python -m experiments.agreement runs/laptop human.json dsage.json

Elites spread over the archive's objective, and any layout files, under our planner at low and high
effort and under priority-based search by its published and its plain rule. Every run is a row of
runs.csv and is not simulated again, so this can be stopped and started again.
"""

import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import tyro
from scipy import stats

import qdenv
from experiments.ledger import Case, complete
from experiments.pieces import table
from experiments.program import run_program
from experiments.traffic import name_layouts
from qdenv.domains.base import make_domain
from qdenv.io.files import write_csv
from qdenv.ranges import NonNegativeInt
from qdenv.stats import Sample, sample_of
from qdenv.study.options import parse_seeds
from qdenv.study.plans import read_plan
from qdenv.view.style import new_figure, save_figure, styled

PAPER = "published"  # the planner that the others are compared with
PLANNERS = ("low", "high", "plain", PAPER)
PARTED = 6  # layouts listed of each planner
RESAMPLES = 2000  # of the layouts, for an interval
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


def subjects_of(run: qdenv.RunDirectory, count: int, files: Sequence[Path]) -> Iterator[Subject]:
    """Take elites spread over the objective, and layout files of the run's domain."""
    archive, domain = run.archive, make_domain(run.config.evaluation.domain)
    columns, cells = archive.columns, archive.cells
    # At equal steps of rank, from the worst to the best.
    order = np.argsort(columns["objective"], kind="stable")
    places = np.linspace(0, len(order) - 1, min(count, len(order))).round().astype(int)
    for row in order[places]:
        flowed = not np.any(columns["congested"][row]) if "congested" in columns else True
        name = "elite " + ",".join(map(str, cells[row]))
        known = (float(columns["objective"][row]), flowed, columns["measures"][row])
        yield Subject(name, columns["repaired"][row], *known)
    for name, path in name_layouts(files).items():
        tiles = read_plan(path, domain.name).layout
        values = [axis.value(jnp.asarray(tiles), None) for axis in domain.measures if axis.value]
        yield Subject(name, tiles, np.nan, True, np.array(values, float))


class Correlation(NamedTuple):
    """A rank correlation over layouts."""

    value: float  # of them; NaN with fewer than three layouts, or where a judge tells none apart
    low: float  # lower end of its 95 % bootstrap interval over layouts; NaN where it has none
    high: float  # upper end


class Agreement(NamedTuple):
    """How far two judges agree."""

    layouts: int  # how many both judged
    spearman: Correlation  # rank correlation
    kendall: Correlation  # the correlation tau-b of the order of pairs
    ratio: Sample  # of what the one says over what the other says, where that is above 0


def agree(ours: np.ndarray, theirs: np.ndarray) -> Agreement:
    """Compare two judges of the same layouts (float [layouts] each)."""
    moved = theirs > 0
    ratio = sample_of(ours[moved] / theirs[moved] if moved.any() else np.array([np.nan]))
    spearman, kendall = (correlate(kind, ours, theirs) for kind in ("spearman", "kendall"))
    return Agreement(len(ours), spearman, kendall, ratio)


def correlate(kind: str, ours: np.ndarray, theirs: np.ndarray, seed: int = 0) -> Correlation:
    """Correlate the ranks that two judges give.

    The interval is bias-corrected and accelerated (Efron 1987, "Better bootstrap confidence
    intervals", https://doi.org/10.1080/01621459.1987.10478410); `kind`: "spearman" or "kendall".
    """
    if len(ours) < 3:
        return Correlation(np.nan, np.nan, np.nan)
    measure = {"spearman": stats.spearmanr, "kendall": stats.kendalltau}[kind]
    options: Any = {"n_resamples": RESAMPLES, "paired": True, "vectorized": False}
    options["random_state"] = np.random.default_rng(seed)
    with warnings.catch_warnings():  # a resample of equal layouts has no correlation
        warnings.simplefilter("ignore")
        found = stats.bootstrap((ours, theirs), lambda *pair: measure(*pair).statistic, **options)
        low, high = found.confidence_interval
        return Correlation(float(measure(ours, theirs).statistic), float(low), float(high))


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


def print_parting(
    subjects: Sequence[Subject], judged: Judged, planner: str, axes: Sequence[str]
) -> None:
    """Print the flowing layouts that a planner ranks most unlike the paper's, and what goes along.

    What goes along is Spearman's correlation of the difference in rank with each measure.
    """
    places = np.flatnonzero(judged.flows(planner)).tolist()
    ours, theirs = judged.mean(planner)[places], judged.mean(PAPER)[places]
    ranked, paper = stats.rankdata(ours), stats.rankdata(theirs)
    parting = ranked - paper
    print(f"\n{planner} and {PAPER}: where ranks part most, of {len(places)} layouts (1: worst)")
    for at in map(int, np.argsort(-np.abs(parting), kind="stable")[:PARTED]):
        subject = subjects[places[at]]
        measures = zip(axes, subject.measures, strict=True)
        known = "".join(f", {name} {value:.4g}" for name, value in measures)
        ranks = f"rank {ranked[at]:g} ({ours[at]:.3f}) against {paper[at]:g} ({theirs[at]:.3f})"
        print(f"{subject.name}: {ranks}{known}")
    for axis, name in enumerate(axes):
        values = np.array([subjects[place].measures[axis] for place in places])
        rho, low, high = correlate("spearman", parting, values)
        print(f"difference in rank with {name}: {rho:.2f} ({low:.2f} to {high:.2f})")


def write_table(
    path: Path, subjects: Sequence[Subject], judged: Judged, axes: Sequence[str]
) -> None:
    """Write a row per layout: what each planner makes of it, and how many runs congest.

    Layouts that congest are printed.
    """
    head = ["layout", "objective", *axes, *PLANNERS, *(f"{name}_congested" for name in PLANNERS)]
    rows, runs = [], judged.throughput[PAPER].shape[1]
    for place, subject in enumerate(subjects):
        means = [judged.mean(planner)[place] for planner in PLANNERS]
        numbers = [f"{number:.6g}" for number in (subject.objective, *subject.measures, *means)]
        jams = {planner: judged.jams[planner][place] for planner in PLANNERS}
        rows.append((subject.name, *numbers, *jams.values()))
        if any(jams.values()):
            named = ", ".join(f"{name} {jam} of {runs}" for name, jam in jams.items() if jam)
            print(f"{subject.name} congests: {named}")
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
    figure.legend(*handles, loc="outside lower center", ncols=4, fontsize="small")
    figure.suptitle(title, fontsize="medium")
    save_figure(figure, path)


def main(
    run: Annotated[Path, tyro.conf.Positional],
    layouts: Annotated[tuple[Path, ...], tyro.conf.Positional] = (),
    elites: NonNegativeInt = 40,
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
    runs = complete(out / "runs.csv", cases, chosen)
    # Runs come layout by layout, planner by planner, seed by seed.
    order = (len(subjects), len(PLANNERS), -1)
    throughput = np.array([run.throughput for run in runs]).reshape(order).swapaxes(0, 1)
    jams = np.array([run.congested for run in runs]).reshape(order).sum(axis=2).T
    judged = Judged(*(dict(zip(PLANNERS, one, strict=True)) for one in (throughput, jams)))
    write_table(out / "agreement.csv", subjects, judged, axes)
    title = f"{domain.name}, {agents} agents, {timesteps} timesteps, {len(chosen)} seeds"
    draw(out / "agreement.png", subjects, judged, title)
    print(f"\n{title}; intervals: 95 %, bootstrap over layouts\n")
    head = (f"against {PAPER}", "layouts", "Spearman (95 %)", "Kendall (95 %)", "ratio")
    rows: list[tuple[object, ...]] = []
    for (name, over), one in compare(subjects, judged).items():
        both = ("{:.3f} ({:.3f} to {:.3f})".format(*each) for each in (one.spearman, one.kendall))
        ratio = f"{one.ratio.mean:.4f} ± {one.ratio.error:.4f}"
        rows.append((name, f"{one.layouts} {over}", *both, ratio))
    print("\n".join(table(head, rows)))
    for planner in ("low", "high", "plain"):
        print_parting(subjects, judged, planner, axes)
    print(", ".join(str(out / name) for name in ("runs.csv", "agreement.csv", "agreement.png")))


if __name__ == "__main__":
    run_program(main, "python -m experiments.agreement")
