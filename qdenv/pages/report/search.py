"""The section of a report on the run of which the best layout is reported on."""

from __future__ import annotations

from qdenv.pages.report.blocks import Drawing, Section, Table, Text, drawing
from qdenv.pages.report.subjects import Subject
from qdenv.plots.archive import draw_archive, scatter_objectives
from qdenv.plots.figure import WARNING, paper_figure, styled
from qdenv.plots.runs import draw_progress
from qdenv.study.groups import algorithm_name, group_runs

MAP, CURVES = 5.2, 6.8  # inches
TALL = 0.78  # of its width: the height of the heat map


def search_sections(subjects: list[Subject]) -> list[Section]:
    """Show the archive and the progress of each run."""
    return [_section(one, place) for place, one in enumerate(subjects) if one.run is not None]


def _section(subject: Subject, place: int) -> Section:
    run, elite = subject.run, subject.elite
    assert run is not None and elite is not None
    config, meaning, archive = run.config, run.meaning, run.archive
    name = algorithm_name(config_name(config.algorithm))
    what = f"It is the best of {len(archive):,} of different kinds that {name} kept."
    if run.shipped:
        one = run.shipped.generator
        what = f"It ships with qdenv ({one.about}), one of {len(archive)} from a search by {name}."
    blocks: list[Text | Table | Drawing] = [
        Text(
            f"{what} Each cell of the map is a kind of layout, by its measures; the colour says "
            "how good the best of its kind is. The ring is around this layout."
        )
    ]
    if len(meaning.measures) <= 2:
        heat = paper_figure(MAP, TALL * MAP)
        columns = archive.columns
        filled = scatter_objectives(columns["index"], columns["objective"], meaning.measures)
        styled(draw_archive)(heat, filled, meaning.measures, label=meaning.objective)
        if run.shipped:
            heat.axes[0].set_title("")  # what ships is no measure of what was found
        spot = [*elite.measures.values(), 0.5][:2]
        heat.axes[0].plot(*spot, "o", markersize=9, mfc="none", mec=WARNING, clip_on=False)
        blocks.append(drawing(heat, "The archive of the search.", f"archive-{place}"))
    (group,) = group_runs([run])
    caption = "How the search went on: sum of all objectives, share of filled cells, the best."
    figure = draw_progress([group], meaning.objective, CURVES)
    blocks.append(drawing(figure, caption, f"progress-{place}"))
    last = run.read_metrics()[-1]
    measures = ", ".join(f"{name} {value:.4g}" for name, value in elite.measures.items())
    rows = [
        ("run", subject.source),
        ("domain", subject.plan.domain.name),
        ("algorithm", name),
        ("seed", str(config.seed)),
        ("evaluations", f"{last.evaluations:,}"),
        ("QD-score", f"{last.qd_score:,.1f}"),
        ("coverage", f"{last.coverage:.1%}"),
        ("best objective", f"{last.best_objective:.3f}"),
        ("this layout", f"objective {elite.objective:.3f}, {measures}"),
    ]
    blocks.append(Table(("", ""), rows, f"search-{place}"))
    return Section(f"The search: {subject.name}", blocks)


def config_name(algorithm: object) -> str:
    """Find the registered name of an algorithm's settings."""
    from qdenv.search.registry import ALGORITHMS  # imports an algorithm when it is asked for one

    return ALGORITHMS.name_of(algorithm)
