"""Operations on saved runs: pictures, elites at other sizes, tables."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from tyro.conf import arg

from qdenv.domains.base import DOMAINS, make_domain
from qdenv.io.files import refuse_links, write_csv
from qdenv.io.layouts import check_size, endings_for
from qdenv.ops import options as args
from qdenv.ops.layouts import layout_human
from qdenv.ops.output import AUTO, Layout, Place, place, place_folder, save_with_picture, say
from qdenv.progress import Bar
from qdenv.ranges import PositiveInt, Ranged, Seed
from qdenv.repairs.settings import Polish
from qdenv.run.archive import Elite
from qdenv.run.directory import RunDirectory
from qdenv.shipped import file_name
from qdenv.study import elites as studies
from qdenv.study.groups import CURVES, band_of, group_runs
from qdenv.study.options import describe_growth
from qdenv.study.plans import describe_changes, list_changes
from qdenv.types import InputError, RepairStatus
from qdenv.view import PAGE, parse_width


def plot(
    runs: args.Runs,
    out: args.Out = None,
    form: Annotated[Literal["png", "svg", "pdf"], arg(name="format")] = "png",
    width: args.Width = None,
) -> list[Path]:
    """Draw a run's archive, progress and best layout again, or several runs side by side.

    Args:
        runs: folders of runs; several have one colour scale for their archives, and runs that
            differ only in their seeds one curve of progress, mean and interval.
        out: folder for the pictures; by default a run's own; for a generator of the zoo, one that
            is named after it; for several runs, plots.
        form: format of the pictures.
        width: width of the pictures in inches; by default what suits them.

    Returns:
        the pictures' files.

    Raises:
        InputError: there is no run, or nothing to draw yet.

    Examples:
        ``qdenv plot runs/first --format pdf``
    """
    if not runs:
        raise InputError("give at least one folder of a run")
    inches = None if width is None else parse_width(width)
    runs = list(runs) if isinstance(runs, list | tuple) else [runs]  # in Python one needs no list
    opened = [args.open_run(run) for run in runs]
    if len(opened) == 1:
        own = out in (None, AUTO) and not opened[0].shipped
        folder = None if own else place_folder(out or AUTO, file_name(Path(str(runs[0]))))
        return plot_one(opened[0], folder, form, inches)
    folder = place_folder(out or AUTO, "plots")
    # Runs that differ by their seeds alone are one curve with an interval.
    groups = group_runs(opened)
    from qdenv.view.runs import plot_runs  # imports matplotlib

    pictures = plot_runs(opened, folder, form, inches or PAGE)
    for group in groups:
        ends = []
        for name, word in CURVES.items():
            (mean,), (half,) = band_of(group.curves[name][:, -1:])
            ends.append(f"{word} {mean:.4g}" + f" +- {half:.2g}" * (len(group.runs) > 1))
        say(f"{group.title}: {', '.join(ends)} after {group.evaluations[-1]} evaluations")
    if len(groups) < len(opened):
        say("+-: half the width of the 95 % interval over runs")
    say(*pictures)
    return pictures


def plot_one(
    run: RunDirectory, folder: Path | None = None, form: str = "png", width: float | None = None
) -> list[Path]:
    """Draw a run's pictures, into its own folder unless another is given, and log its figures."""
    if folder is None:
        refuse_links(run.path)
    last = run.read_progress()[-1]
    from qdenv.view.runs import plot_run  # imports matplotlib

    pictures = plot_run(run, folder, form, width)
    say(
        f"QD-score {last.qd_score:.2f}, coverage {last.coverage:.1%}, best objective "
        f"{last.best_objective:.3f} after {last.evaluations} evaluations in {last.seconds:.0f} s",
        *pictures,
    )
    return pictures


@dataclasses.dataclass(frozen=True)
class GrowthOptions(Ranged):
    """How an elite is grown, beyond its size."""

    # instead of an elite's name a value for each measure, like 200 0.8, to take the nearest elite
    measures: tuple[float, ...] = ()
    # steps of growth; by default the number known for the size, or else scaled with it
    steps: PositiveInt | None = None
    # other seeds give other repairs of about equal cost; by default the run's own
    seed: Annotated[Seed | None, arg(aliases=("--repair-seed",))] = None
    # how hard to repair: full lets HiGHS improve the annealed layout, and prove it optimal if it
    # can; by default the search's for a layout that it simulated, and full for any other
    polish: Polish | None = None
    # floor plan; the layout gets its size, numbers of tiles, walls and stations
    plan: args.PlanFile = None
    # what must stay of the plan: tiles (w), a rectangle (0:7,33:40), a drawing; + joins several
    keep: args.KeepCells = None
    frames: PositiveInt | None = None  # steps between drawings of how it grows (Figure 6)


def generate(
    run: args.Run,
    rows: int | None = None,
    cols: int | None = None,
    elite: Annotated[Any, arg(metavar="NAME|CELL", constructor=str)] = "best",
    repair: bool = True,
    growth: Annotated[GrowthOptions, arg(name="")] = GrowthOptions(),
    out: args.Out = None,
    **numbers: args.Number,
) -> Layout:
    """Grow an elite of a run at any size and repair it.

    Args:
        run: folder of the run.
        rows: rows of the layout; by default the trained size.
        cols: columns of the layout; by default the trained size.
        elite: "best" or another name in the zoo, or the indices of an archive cell like 12,40;
            in Python also (12, 40) or what `run.elite` found.
        repair: --no-repair keeps what the automaton drew.
        growth: steps, seed, plan, what must stay, frames.
        out: layout file to write (.json, .txt, .csv, .xlsx, .dxf), with a picture beside it; by
            default layout.json.
        **numbers: exact numbers of tiles; by default those known for the size, or else scaled
            with the area. In Python also what `growth` holds, like ``steps`` and ``seed``.

    Returns:
        the layout, with elite, steps and repair among its facts.

    Raises:
        InputError: there is no such elite, or no layout of this size obeys the rules.

    Examples:
        ``qdenv generate zoo:warehouse-even/best --rows 57 --cols 58 --out plan.txt``
    """
    stated: Any = {name: numbers.pop(name) for name in vars(growth).keys() & numbers.keys()}
    growth = dataclasses.replace(growth, **stated)
    if not repair and (numbers or growth.polish or growth.seed is not None):
        raise InputError("without repair: leave out numbers of tiles, seed and polish")
    # A size that is not stated is the trained one, which needs no check.
    check_size(1 if rows is None else rows, 1 if cols is None else cols)
    opened = args.open_run(run)
    plan = None if growth.plan is None else args.read_plan(growth.plan)
    named = not isinstance(elite, Elite)
    found = opened.archive.elite(elite, growth.measures or None) if named else elite
    config = opened.config
    trained = make_domain(config.evaluation.domain)
    whose = trained if plan is None else plan.domain
    endings = endings_for(whose.tiles, whose.meanings)
    target = place(out, "layout.json", endings, [growth.plan, growth.keep])
    size = rows, cols
    with Bar("growing") as bar:
        grown = studies.grow_elite(opened, found, size, growth.steps, numbers, growth.keep, plan)
        domain, layout = grown.domain, grown.layout
        if growth.frames is not None:
            from qdenv.view.layouts import draw_frames  # imports matplotlib
            from qdenv.view.style import save_figure

            frames = (target or Place(Path("layout.json"), False)).beside("_frames.png").path
            after, grids = studies.grow_frames(opened, grown, growth.frames)
            save_figure(draw_frames(grids, after, domain.tiles), frames)
            say(f"{frames}: after {', '.join(map(str, after))} steps")
        # With the run's own seed, the elite at its trained size is the layout that was evaluated.
        seed = config.seed if growth.seed is None else growth.seed
        if growth.polish:
            grown = grown._replace(repair=dataclasses.replace(grown.repair, polish=growth.polish))
        repaired = studies.repair_grown(grown, seed, bar) if repair else None
    chosen = [*(numbers if repair and plan is None else domain.counted)]
    chosen += ["steps"] * bool(growth.steps)
    say(*filter(None, [describe_growth(trained, domain.shape, chosen)]))
    if trained.config.keep and not domain.config.keep:
        drawn = "WARNING: the run keeps cells of layouts of {} x {}".format(*trained.shape)
        say(f"{drawn}; at this size nothing is kept unless --keep names it")
    details: dict[str, Any] = {"domain": domain.name, "elite": found.cell, "steps": grown.steps}
    if repaired is not None:
        layout = np.asarray(repaired.layout)
        status = RepairStatus(int(repaired.status)).name.lower()
        cost, bound = float(repaired.cost), float(repaired.lower_bound)
        details |= {"repair": status, "changed": cost, "lower_bound": bound}
        say(f"repair: {status}, {cost:g} cells changed, {bound:g} at least")
        say(*describe_changes(list_changes(grown.layout, layout, domain)))
    costs = studies.draw_grown_costs(config.evaluation, grown, layout)
    has = domain.numbers if repair else domain.fitted(layout).numbers
    facts = {"rows": layout.shape[0], "cols": layout.shape[1], **has, **details}
    settings = {"run": str(run), "elite": found.cell, "seed": seed}
    details |= {} if plan is None else plan.facts.details
    made = save_with_picture(Layout(layout, domain, details, facts, costs), target)
    return dataclasses.replace(made, facts=facts | {"settings": settings})


def series(
    run: args.Run,
    elite: str = "best",
    sizes: tuple[str, ...] = (),
    steps: tuple[int, ...] = (),
    seed: Annotated[Seed | None, arg(aliases=("--repair-seed",))] = None,
    human: bool = False,
    out: args.Out = None,
    **numbers: args.Numbers,
) -> list[Layout]:
    """Grow one elite at many sizes, by default those of the paper's Figure 18.

    Args:
        run: folder of the run.
        elite: "best", or the indices of an archive cell like 12,40.
        sizes: rows and columns of each layout, like 33x36 57x58; by default seven sizes from
            33x36 to 101x102. In Python also (33, 36).
        steps: steps of growth for each size; by default those known for it, or else scaled.
        seed: other seeds give other repairs of about equal cost; by default the run's own.
        human: also draw what people design at each size.
        out: folder for the layouts, their pictures and series.csv; by default series.
        **numbers: exact numbers of tiles for each size; by default those known for it, or else
            scaled with the area. Aisles and racks are the same for all.

    Returns:
        a layout for each size.

    Raises:
        InputError: there is no such elite, or no layout of a size obeys the rules.

    Examples:
        ``qdenv series runs/first --sizes 33x36 57x58``
    """
    opened = args.open_run(run)
    domain = make_domain(opened.config.evaluation.domain)
    rules: dict[str, Any] = {
        name: numbers.pop(name) for name in domain.rule_settings if name in numbers
    }
    domain = domain.resized(*domain.shape, rules)
    shapes = [studies.parse_size(text) for text in sizes] or list(studies.SIZES)
    for shape in shapes:
        check_size(*shape)
        if shapes.count(shape) > 1:
            raise InputError("size {}x{} twice: name each once".format(*shape))
    if human and domain.human is None:
        raise InputError(f"{domain.name} has no hand-made design: leave --human out")
    folder = None if out is None else place_folder(out, "series")
    stated, grown, layouts = [*numbers, *(["steps"] if steps else [])], [], []
    for item in studies.grow_sizes(opened, elite, shapes, steps, numbers, seed, rules):
        rows, cols = item.layout.shape
        say(*filter(None, [describe_growth(domain, (rows, cols), stated)]))
        grown.append(studies.details(item))
        details = grown[-1] | {"domain": domain.name}
        target = place(folder and folder / f"nca_{rows}x{cols}.json", "layout.json")
        made = Layout(item.layout, domain.resized(rows, cols), details, details, item.costs)
        layouts.append(save_with_picture(made, target))
        if human:
            name = folder and folder / f"human_{rows}x{cols}.json"
            layouts.append(layout_human(rows, cols, domain.name, name))
    if table := place(folder and folder / "series.csv", "series.csv"):
        write_csv(table.path, list(grown[0]), [list(one.values()) for one in grown])
        say(table)
    return layouts


def export(
    run: args.Run, out: args.Out = None, layouts: Path | None = None, solutions: bool = False
) -> list[Path]:
    """Write the elites of a run as a table, and their layouts.

    The table has a row for each elite: its cell (in the form of --elite), its objective, each
    measure by its name, and what was counted in its simulations.

    Args:
        run: folder of the run.
        out: table to write, .csv or .parquet; by default RUN_elites.csv.
        layouts: folder for the layouts, a file for each elite, named by its cell.
        solutions: add the parameters of the generators to the table.

    Returns:
        the table, and the folder of layouts, that were written.

    Raises:
        InputError: there is no run, a name is impossible, or a package is missing.

    Examples:
        ``qdenv export runs/first --layouts plans``
    """
    opened, written = args.open_run(run), []
    archive = opened.archive
    layouts = None if layouts is None else place_folder(layouts, "layouts")
    if table := place(out, f"{file_name(Path(str(run)))}_elites.csv", (".csv", ".parquet")):
        archive.write_table(table.path, solutions)
        say(f"{table}: {len(archive)} elites")
        written.append(table.path)
    if layouts is not None:
        archive.write_layouts(layouts, DOMAINS.name_of(opened.config.evaluation.domain))
        say(f"{layouts}: {len(archive)} layouts")
        written.append(layouts)
    return written
