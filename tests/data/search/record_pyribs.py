"""Record what pyribs (ribs 0.12) does, as oracle of tests/test_search_parity.py.

Run by hand with the `pyribs` extra installed: ``python tests/data/search/record_pyribs.py``.
"""

from pathlib import Path

import numpy as np
from ribs.archives import GridArchive
from ribs.emitters import EvolutionStrategyEmitter
from ribs.emitters.opt import (
    CMAEvolutionStrategy,
    LMMAEvolutionStrategy,
    SeparableCMAEvolutionStrategy,
)

HERE = Path(__file__).parent
DIMS, RANGES = (6, 5), ((-1.0, 1.0), (0.0, 3.0))


def record_archive() -> dict[str, np.ndarray]:
    """Add 60 x 12 batches of 30 rows, with ties, crowded cells and measures out of range."""
    rng = np.random.default_rng(1)
    cases, batches, rows = 60, 12, 30
    settings = [(0.01, 0.0), (0.1, -5.0), (0.5, 0.0), (1.0, -5.0), (1.0, -np.inf)]
    rates = np.array([settings[case % len(settings)] for case in range(cases)])
    # Eighths and hundredths in small integers: exact, tied now and then, and small on disk.
    objective = rng.integers(-60, 60, (cases, batches, rows)).astype(np.int8)
    objective = (objective * rng.uniform(0.2, 1, (cases, 1, 1))).astype(np.int8)
    measures = rng.integers(-110, 110, (cases, batches, rows, 2)).astype(np.int8)
    status = np.zeros((cases, batches, rows), np.int8)
    value = np.zeros((cases, batches, rows))
    cells = int(np.prod(DIMS))
    final = {name: np.zeros((cases, cells)) for name in ("threshold", "objective")}
    winner = np.full((cases, cells), -1, np.int16)
    for case, (learning_rate, threshold_min) in enumerate(rates):
        archive = GridArchive(
            solution_dim=1,
            dims=DIMS,
            ranges=RANGES,
            learning_rate=learning_rate,
            threshold_min=threshold_min,
            dtype=np.float64,
        )
        for batch in range(batches):
            names = batch * rows + np.arange(rows)
            info = archive.add(
                names[:, None].astype(float),
                objective[case, batch] / 8,
                measures[case, batch] / 50 + np.array([0.0, 1.5]),
            )
            status[case, batch], value[case, batch] = info["status"], info["value"]
        data = archive.data()
        final["threshold"][case, data["index"]] = data["threshold"]
        final["objective"][case, data["index"]] = data["objective"]
        winner[case, data["index"]] = data["solution"][:, 0]
    return {
        "rates": rates,
        "objective_eighths": objective,
        "measure_fiftieths": measures,
        "status": status,
        "value": value,
        "winner": winner,
        "final_threshold": final["threshold"],
        "final_objective": final["objective"],
    }


class Draws:
    """A random generator whose normal draws are given beforehand."""

    def __init__(self, noise: np.ndarray) -> None:
        """Remember the draws [b, P] of the next ask."""
        self.noise = noise

    def normal(self, loc: float, scale: float, size: tuple) -> np.ndarray:
        """Give the draws scaled."""
        return loc + scale * self.noise

    def standard_normal(self, size: tuple) -> np.ndarray:
        """Give the draws."""
        return self.noise


def record_strategy(make: type, dim: int, batch: int, fields: tuple[str, ...]) -> dict:
    """Run 60 iterations of an optimiser with random ranks and 0..b parents."""
    rng = np.random.default_rng(2)
    iterations = 60
    noise = rng.normal(size=(iterations, batch, dim)).astype(np.float16)
    order = np.stack([rng.permutation(batch) for _ in range(iterations)]).astype(np.int8)
    parents = rng.integers(0, batch + 1, iterations).astype(np.int8)
    opt = make(sigma0=0.5, solution_dim=dim, batch_size=batch, seed=0)
    opt.reset(np.linspace(-1, 1, dim))
    out: dict[str, list] = {name: [] for name in ("solutions", "refreshed", *fields)}
    for step in range(iterations):
        opt._rng = Draws(noise[step].astype(float))
        out["solutions"].append(np.array(opt.ask()))
        opt.tell(order[step], np.arange(batch, dtype=float), int(parents[step]))
        for name in fields:
            got = opt.cov.cov if name == "cov" else getattr(opt, name)
            out[name].append(np.array(got))
        out["refreshed"].append(getattr(getattr(opt, "cov", None), "updated_eval", 0))
    if "cov" in out and dim > 1 and out["cov"][0].ndim == 2:
        out["cov"] = out["cov"][::6]  # every sixth matrix is proof enough
    return {"noise": noise, "order": order, "parents": parents} | {
        name: np.array(values) for name, values in out.items()
    }


def record_emitters(ranker: str, selection: str, restart: str | int) -> dict[str, np.ndarray]:
    """Run three emitters on one archive, and write down when each of them restarts."""
    rng = np.random.default_rng(3)
    emitters, batch, dim, iterations = 3, 6, 5, 25
    archive = GridArchive(
        solution_dim=dim,
        dims=DIMS,
        ranges=RANGES,
        learning_rate=0.1,
        threshold_min=0.0,
        seed=0,
        dtype=np.float64,
    )
    team = [
        EvolutionStrategyEmitter(
            archive,
            x0=np.zeros(dim),
            sigma0=0.5,
            ranker=ranker,
            selection_rule=selection,
            restart_rule=restart,
            batch_size=batch,
            seed=seed,
        )
        for seed in range(emitters)
    ]
    for emitter in team:
        emitter._opt.lazy_gap_evals = np.inf  # stays isotropic
    names = ("solutions", "objective", "measures", "mean", "sigma", "path", "restarts")
    out: dict[str, list] = {name: [] for name in names}
    for _ in range(iterations):
        out["mean"].append([emitter._opt.mean.copy() for emitter in team])
        out["sigma"].append([emitter._opt.sigma for emitter in team])
        out["path"].append([emitter._opt.ps.copy() for emitter in team])
        solutions = np.concatenate([emitter.ask() for emitter in team])
        objective = 4 - np.square(solutions).sum(axis=1) + rng.normal(size=18)
        if ranker == "2imp":  # ties; the other ranker's order of ties differs between machines
            objective = np.round(objective, 1)
        measures = solutions[:, :2] * 0.5 + np.array([0.0, 1.5])
        info = archive.add(solutions, objective, measures)
        for row, emitter in enumerate(team):
            part = slice(row * batch, (row + 1) * batch)
            mine = {name: values[part] for name, values in info.items()}
            emitter.tell(solutions[part], objective[part], measures[part], mine)
        for name, values in (
            ("solutions", solutions),
            ("objective", objective),
            ("measures", measures),
            ("restarts", [emitter.restarts for emitter in team]),
        ):
            out[name].append(values)
    return {name: np.array(values) for name, values in out.items()}


def main() -> None:
    """Write all recordings beside this file."""
    np.savez_compressed(HERE / "archive.npz", **record_archive())
    fields = ("mean", "sigma", "ps", "pc", "cov")
    for name, make, kept in (
        ("full", CMAEvolutionStrategy, fields),
        ("separable", SeparableCMAEvolutionStrategy, fields),
        ("limited_memory", LMMAEvolutionStrategy, ("mean", "sigma", "ps")),
    ):
        np.savez_compressed(HERE / f"{name}.npz", **record_strategy(make, 12, 8, kept))
    for name, rules in (
        ("emitters_imp", ("imp", "mu", "no_improvement")),
        ("emitters_2imp", ("2imp", "filter", "no_improvement")),
        ("emitters_period", ("2imp", "mu", 7)),
    ):
        np.savez_compressed(HERE / f"{name}.npz", **record_emitters(*rules))


if __name__ == "__main__":
    main()
