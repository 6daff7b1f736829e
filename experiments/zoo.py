"""Choose about ten generators of a finished run, measure them, and write them into the zoo.

    python -m experiments.zoo runs/warehouse-even
    python -m experiments.zoo runs/warehouse-even --further runs/warehouse-even-further

Each rule orders the elites of the run, and of further ones. Of a few that no other rule has taken,
the first is chosen whose layout of the evaluation size can be repaired and flows in a short trial,
or the first of all, if none does. The best is the one that is worth most at that size among a few
(of fleets, from all over the archive), and flows there under priority-based search, too, if any
does. Every simulation of a fleet is a row of a file and is not repeated, so this can be stopped and
started again.
"""

import shutil
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import jax
import numpy as np
import tyro

from experiments.growing import Cell, Measuring, Workshop
from experiments.program import run_program
from experiments.runs import FILES
from experiments.zoo_rules import RULES, Rule
from qdenv.configurations import PRESETS
from qdenv.domains.base import DOMAINS
from qdenv.io.arrays import write_arrays
from qdenv.io.files import tidy, write_json
from qdenv.io.records import read_json
from qdenv.pipeline import evaluate
from qdenv.run.archive import SavedArchive
from qdenv.run.directory import RunDirectory
from qdenv.run.experiment import make_experiment, observed
from qdenv.search.registry import ALGORITHMS
from qdenv.shipped import HOME, TABLE, USUAL, Collection, NamedGenerator, Origin
from qdenv.study.elites import Unrepaired, grow_series, repair_grown
from qdenv.types import InputError, look_up


def numbers_of(archive: SavedArchive) -> dict[str, np.ndarray]:
    """List what rules order elites by, float [elites] each."""
    found = {
        name: values.astype(float).reshape(len(values), -1).mean(axis=1)
        for name, values in archive.columns.items()
        if name not in ("solution", "measures") and values.ndim <= 2
    }
    measures = archive.columns["measures"].T.astype(float)
    names = (axis.name for axis in archive.schema.measures)
    return found | dict(zip(names, measures, strict=True))


def in_order(rule: Rule, numbers: Mapping[str, np.ndarray], elites: np.ndarray) -> np.ndarray:
    """Order the elites (int [n]) that a rule's steps leave; the first of equal ones stays first."""
    for number, share in (*rule.steps, (rule.order, 1.0)):
        values = numbers[number.removeprefix("-")][elites]
        places = np.argsort(values if number.startswith("-") else -values, kind="stable")
        elites = elites[places][: max(1, round(share * len(elites)))]
    return elites


def spread(cells: Iterable[Cell], apart: int) -> list[Cell]:
    """Keep the first cell in each square of `apart` cells; all of them where that is 0."""
    firsts: dict[Cell, Cell] = {}
    for cell in cells:
        firsts.setdefault(tuple(place // max(apart, 1) for place in cell), cell)
    return list(firsts.values())


def choose(workshop: Workshop, rules: tuple[Rule, ...]) -> dict[Rule, Cell]:
    """Choose a cell of the archive for each rule."""
    archive, columns = workshop.archive, workshop.archive.columns
    numbers, cells = numbers_of(archive), archive.cells
    # Those that flowed or were solvable in all simulations of the search.
    congested = columns.get("congested", np.zeros((len(archive), 1), bool))
    elites = np.flatnonzero(~congested.any(axis=1) & (columns["objective"] > 0))
    chosen: dict[Rule, Cell] = {}
    for rule in rules:
        ordered = (tuple(map(int, cells[row])) for row in in_order(rule, numbers, elites))
        free = spread((cell for cell in ordered if cell not in chosen.values()), rule.apart)
        if not free:
            raise InputError(f"{rule.name}: the run has too few elites: search for longer")
        tried = free[: rule.tried]
        if rule.name == USUAL:
            tried.sort(key=workshop.worth, reverse=True)
            chosen[rule] = next((cell for cell in tried if workshop.flows(cell)), tried[0])
        else:
            chosen[rule] = next((cell for cell in tried if workshop.worth(cell) >= 0), free[0])
        print(f"{rule.name}: {chosen[rule]}", flush=True)
    return chosen


def origin_of(workshop: Workshop, domain: str) -> Origin:
    """Return the run that generators come from."""
    run = workshop.run
    counted = "throughput [tasks per timestep]" if workshop.fleet else "actions to the goal"
    config, manifest = run.config, read_json(run.path / "manifest.json", dict[str, Any])
    alike = [name for name, one in PRESETS.items() if one.evaluation == config.evaluation]
    preset = domain if domain in alike else next(iter(alike), domain)
    version, created = manifest["versions"]["qdenv"], manifest["created"]
    algorithm = ALGORITHMS.name_of(config.algorithm)
    done = run.read_metrics()[-1].evaluations
    more = sum(one.read_metrics()[-1].evaluations for one in workshop.further)
    start = config.start
    return Origin(preset, algorithm, config.seed, done, version, created, counted, more, start)


def as_generated(run: RunDirectory, columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Evaluate elites again whose repaired layout is not the one that `qdenv generate` makes.

    Further runs may have repaired with seeds of their own, and only `run` is in the zoo. The cells
    stay, as they are names; measures may lie just outside of theirs.
    """
    experiment = make_experiment(run.config)
    pipeline, config = experiment.pipeline, run.config.evaluation
    if pipeline.domain.rules is None:
        return dict(columns)
    changed = []
    for row, solution in enumerate(columns["solution"]):
        (layout,) = grow_series(config, pipeline.domain, solution, [config.generator.steps])
        grown = Unrepaired(pipeline.domain, None, layout, config.generator.steps, config.repair)
        repaired = repair_grown(grown, run.config.seed)
        if repaired is not None and (repaired.layout != columns["repaired"][row]).any():
            changed.append(row)
    if not changed:
        return dict(columns)
    again = jax.jit(partial(evaluate, pipeline))(
        columns["solution"][changed], experiment.evaluation_key
    )
    fresh = observed(again) | {"measures": again.score.measures}
    fresh["objective"] = again.score.result_objective
    made = {name: np.array(values) for name, values in columns.items()}
    for name in made.keys() & fresh.keys():
        made[name][changed] = fresh[name]
    return made


def main(
    run_dir: tyro.conf.Positional[Path],
    measuring: Annotated[Measuring, tyro.conf.arg(name="")] = Measuring(),  # noqa: B008 (frozen)
    ledger: Path | None = None,
    out: Path = HOME,
    further: tuple[Path, ...] = (),
) -> None:
    """Write the zoo of the run's domain.

    Args:
        run_dir: folder of a finished run.
        measuring: what is simulated.
        ledger: CSV file that keeps every simulation; zoo-DOMAIN.csv beside the run unless given.
        out: folder of the zoo.
        further: folders of further runs that began at elites; theirs count like its own.
    """
    run = RunDirectory.open(run_dir)
    domain = DOMAINS.name_of(run.config.evaluation.domain)
    rules = look_up(RULES, domain, "domain of the zoo")
    every = [run, *map(RunDirectory.open, further)]
    folder = out / domain
    if folder.resolve() in [one.path.resolve() for one in every]:
        raise InputError(f"{folder}: the zoo would replace this run: give another --out")
    workshop = Workshop(every, measuring, ledger or run_dir.with_name(f"zoo-{domain}.csv"))
    chosen = choose(workshop, rules)
    archive = workshop.archive
    places = [int(np.ravel_multi_index(cell, archive.shape)) for cell in chosen.values()]
    rows = [int(np.flatnonzero(archive.columns["index"] == place)[0]) for place in places]
    columns = as_generated(run, {name: one[rows] for name, one in archive.columns.items()})
    found = tuple(
        NamedGenerator(
            rule.name,
            rule.about,
            cell,
            tidy(columns["objective"][row]),
            tuple(workshop.measure(cell, shape) for shape in workshop.shapes),
        )
        for row, (rule, cell) in enumerate(chosen.items())
    )
    collection = Collection(domain, origin_of(workshop, domain), found)
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for name in FILES:
        shutil.copyfile(run.path / name, folder / name)
    write_arrays(folder / "archive.npz", columns, compressed=True)
    write_json(folder / TABLE, asdict(collection))
    size = sum(path.stat().st_size for path in folder.iterdir())
    print(f"{folder}: {len(found)} generators, {size / 1e6:.2f} MB")


if __name__ == "__main__":
    run_program(main, "python -m experiments.zoo")
