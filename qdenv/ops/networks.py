"""Operations on networks: the agent of mazes is trained, evaluated, converted; surrogates."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from annotated_types import Interval
from tyro.conf import Positional, arg

from qdenv.agent.settings import TrainConfig, refuse_second_training
from qdenv.io.files import write_csv
from qdenv.io.records import read_json
from qdenv.ops import options as args
from qdenv.ops.output import AUTO, Layout, Place, Result, format_table, place, place_table, say
from qdenv.progress import Bar
from qdenv.ranges import PositiveInt, Ranged, Seed
from qdenv.run.directory import RunDirectory
from qdenv.shipped import file_name
from qdenv.study.options import find_surrogate, parse_seeds
from qdenv.study.plans import Plan
from qdenv.study.recordings import MAZES, trace_agent
from qdenv.types import InputError

if TYPE_CHECKING:  # imports jax
    from qdenv.agent.evaluate import Comparison

_MOST_MAZES = 10_000


def train_agent(
    config: Annotated[TrainConfig, arg(name="")] = TrainConfig(),  # noqa: B008 (frozen)
    path: Annotated[Path, arg(name="out", aliases=("--run-dir",))] = Path("runs/agent"),
    resume: bool = False,
    report_every: PositiveInt = 50,
    cpu_seconds: Annotated[float, Interval(gt=0)] = float("inf"),
) -> Path:
    """Train an agent for mazes: PPO on random mazes.

    Args:
        config: the run.
        path: folder of the run: log, checkpoint, agent.npz, and in agents/ one per line of the log.
        resume: continue from the folder's checkpoint with this `config`; `qdenv resume FOLDER`
            continues with its own.
        report_every: updates between two lines of the log.
        cpu_seconds: stop after about this many CPU seconds, ready to be resumed.

    Returns:
        the agent's file.

    Raises:
        InputError: there is a run in the folder already, or none to resume.

    Examples:
        ``qdenv train-agent --out agents/first``
    """
    path = Path(path)
    if not resume:
        RunDirectory(path).demand_own()
        refuse_second_training(path)
    elif not (path / "checkpoint.npz").exists():
        raise InputError(f"{path}: no run to resume (checkpoint.npz is missing)")
    elif config.steps < read_json(path / "config.json", TrainConfig).steps:
        raise InputError(f"{path}: more steps are configured already: give as many, or more")
    from qdenv.agent.train import train_agent as train  # imports jax and optax

    with Bar("training the agent", total=1) as bar:

        def show(done: int, row: dict[str, Any] | None) -> None:
            bar("training the agent", done / config.updates)
            if row:
                exams = [
                    f"{row[name]:.0%} (mean {row[f'mean_{name}']:.0%}) of {name[5:]} walls"
                    for name in row
                    if name.startswith("exam_")
                ]
                say(f"update {done} of {config.updates}: solves {', '.join(exams)}")

        agent: Path = train(config, path, resume, report_every, cpu_seconds, show)
    say(agent)
    return agent


@dataclass(frozen=True)
class EpisodeOptions(Ranged):
    """The agent, and how often and how long it walks through a maze."""

    agent: str = ""  # an agent.npz; by default the shipped one
    runs: Annotated[int, Interval(ge=1, le=1_000_000)] = 100  # independent episodes, in each maze
    # most actions per episode; by default twice the tiles of the maze with its ring
    timesteps: Annotated[PositiveInt | None, arg(aliases=("--horizon",))] = None
    seed: Seed = 0  # seed of headings, actions and random mazes
    reference_batching: bool = False  # repeat the published evaluation's two quirks, for comparison


def evaluate_agent(
    layout: args.Source,
    episodes: Annotated[EpisodeOptions, arg(name="")] = EpisodeOptions(),
    random_mazes: int = 0,
    out: args.Out = None,
    gif: args.Picture = None,
) -> Result:
    """Let the agent try a maze many times: success rate with its 95 % interval.

    Args:
        layout: layout file of a maze, with or without its ring of walls.
        episodes: the agent, how often and how long it walks.
        random_mazes: also solve this many random mazes with as many walls and a path length within
            0.8 to 1.2 of this one's.
        out: table of the random mazes (.csv), with a folder of their layout files and a picture of
            them beside it; by default LAYOUT_random.csv.
        gif: film of one episode to draw.

    Returns:
        ``rate`` with its 95 % interval ``low`` to ``high``, ``mean_length`` in actions,
        ``shortest`` in moves, and what random mazes gave.

    Raises:
        InputError: it is not a maze, or a number is impossible.

    Examples:
        ``qdenv evaluate-agent maze.txt``
    """
    if random_mazes and not 2 <= random_mazes <= _MOST_MAZES:  # one has no standard error
        limits = f"give 2 to {_MOST_MAZES:,}, or leave it out"
        raise InputError(f"--random-mazes {random_mazes}: {limits}")
    if out not in (None, AUTO) and not random_mazes:
        raise InputError("--out is for the table of random mazes: add --random-mazes 100")
    plan, name = args.read_plan(layout), args.name_of(layout)
    if plan.domain.name not in MAZES:
        raise InputError(f"{name}: a layout of {plan.domain.name}, the agent walks in mazes")
    if random_mazes and episodes.reference_batching:
        raise InputError("--reference-batching is for one maze: leave --random-mazes out")
    picture = place(gif, "episode.gif", (".gif",), [layout])
    # The command line always names a table.
    table = place(out if random_mazes else None, f"{plan.name}_random.csv", (".csv",), [layout])
    if table and table.beside("").path.is_file():
        raise InputError(f"{table.beside('').path}: that is a file, and random mazes need a folder")
    # These import jax: refusals are faster without it.
    from qdenv.agent.evaluate import compare_with_random, default_horizon
    from qdenv.agent.evaluate import evaluate_agent as measure_success
    from qdenv.simulation.maze.policy import load_weights

    maze, weights, seed = plan.layout, load_weights(episodes.agent), episodes.seed
    steps, runs = episodes.timesteps or default_horizon(maze), episodes.runs
    with Bar(f"solving {name} {runs} times"):
        result = measure_success(weights, maze, seed, runs, steps, episodes.reference_batching)
    facts = result._asdict()
    say(
        f"success {result.rate:.1%} ({result.low:.1%} to {result.high:.1%}) in {result.runs} runs "
        f"of at most {steps} timesteps, {result.mean_length:.0f} actions on average, shortest path "
        f"{result.shortest} moves"
    )
    if number := random_mazes:
        with Bar("drawing random mazes") as bar:
            others = compare_with_random(weights, maze, number, runs, seed, steps, progress=bar)
        facts["random_mazes"] = _report_random(table, others, plan, result.rate)
    if picture:
        from qdenv.view.film import save_film

        motion = trace_agent(plan, seed, steps, weights)
        save_film(picture.path, plan.layout, plan.domain.tiles, motion, (0, motion.steps))
        say(picture)
    agent = episodes.agent or "the shipped one"
    settings = {"layout": name, "timesteps": steps, "seed": seed, "agent": agent}
    return Result(facts | {"settings": settings})


def _report_random(
    table: Place | None, others: Comparison, plan: Plan, own: float
) -> dict[str, Any]:
    """Describe random mazes by facts; write their table, layouts and a picture if `table` is given.

    They are compared with the maze `plan`, on which the agent succeeds with the rate `own`.
    """
    lengths = [maze.shortest for maze in others.mazes]
    say(
        f"{len(lengths)} random mazes: {others.mean:.1%} +- {others.standard_error:.1%}, "
        f"{others.walls} walls each, shortest paths of {min(lengths)} to {max(lengths)} moves"
    )
    facts = {
        "mean": others.mean,
        "standard_error": others.standard_error,
        "mazes": len(lengths),
        "walls": others.walls,
        "runs": others.results[0].runs,
        "rates": others.rates,
        "shortest": lengths,
    }
    if table is None:
        return facts
    from qdenv.view.layouts import draw_mazes  # imports matplotlib

    folder, rows = table.beside(""), []
    titles = [f"{plan.name}: path {others.given.shortest}, success {own:.0%}"]
    for number, (maze, one) in enumerate(zip(others.mazes, others.results, strict=True)):
        path = folder.path / f"random_{number:03}.json"
        details = {"walls": others.walls, "shortest": maze.shortest, "success": one.rate}
        Layout(maze.layout, plan.domain, details).save(path)
        counts = (*maze.layout.shape, others.walls, maze.shortest, one.runs)
        rows.append([path, *counts, one.rate, one.low, one.high, one.mean_length])
        titles.append(f"random: path {maze.shortest}, success {one.rate:.0%}")
    columns = ("file", "rows", "cols", "walls", "shortest", "runs", "success", "low", "high")
    say(f"{folder}: {len(rows)} layouts")
    write_csv(table.path, (*columns, "actions"), rows)
    say(table)
    table.beside(".png").draw(draw_mazes([others.given, *others.mazes], titles))
    return facts | {"table": table.path}


def convert_agent(checkpoint: Positional[Path], out: args.Out = None) -> Path:
    """Convert the published agent's checkpoint (model_20000.tar) into a qdenv agent.

    Args:
        checkpoint: your copy of the file; read without PyTorch, nothing in it is executed.
        out: the agent to write; by default agent.npz.

    Returns:
        the agent's file.

    Raises:
        InputError: it is not such a checkpoint.

    Examples:
        ``qdenv convert-agent model_20000.tar``
    """
    target = place(out or AUTO, "agent.npz", (".npz",), [checkpoint])
    assert target is not None
    # These import jax.
    from qdenv.agent.convert import from_torch, read_checkpoint
    from qdenv.agent.train import save_weights

    save_weights(from_torch(read_checkpoint(checkpoint), str(checkpoint)), target.path)
    say(target)
    return target.path


def surrogate(
    run: args.Run,
    seeds: args.Seeds = 3,
    out: args.Out = None,
    plot: args.Picture = None,
    size: Literal["small", "published"] = "small",
    **settings: Annotated[Any, args.Mark.SURROGATE],
) -> Result:
    """Measure how well a surrogate predicts throughput and measures of a run's elites.

    The surrogate is DSAGE's. It learns from four fifths of the elites and predicts the others:
    the repaired layout from the drawn one, then throughput and measures. How much each cell is
    used is not predicted, as no archive has it.

    Args:
        run: folder of the run; its archive needs 50 elites or more.
        seeds: 3 for three random splits, seeds 0 to 2; 3,5,9 for these three; "7," for seed 7.
        out: CSV file to write, a line for each elite held out; by default RUN_surrogate.csv.
        plot: picture to write, predicted over true; by default beside the table.
        size: small suits a CPU, published is the paper's, for a GPU; options replace its numbers.
        **settings: channels, blocks, epochs, minibatch and rate, see `SurrogateConfig`.

    Returns:
        ``skills``: of each number R2, RMSE and rank correlation, mean and spread over the splits.

    Raises:
        InputError: there are too few elites, or a setting is impossible.

    Examples:
        ``qdenv surrogate runs/first --seeds 3``
    """
    config, chosen = find_surrogate(size, settings), parse_seeds(seeds)
    name = file_name(Path(str(run)))
    table, picture = place_table(out, plot, f"{name}_surrogate")
    opened = args.open_run(run)
    _ = opened.archive  # refuses a folder without one, before jax is imported
    from qdenv.study.surrogate import read_elites, scores_to_dict, try_surrogate

    elites = read_elites(opened)
    _, rows, cols = elites.drawn.shape
    plural, blocks = "s" * (len(chosen) > 1), "s" * (config.blocks != 1)
    say(
        f"{name}: {len(elites.numbers)} elites of {rows} x {cols}, a fifth held out, {len(chosen)} "
        f"random split{plural}; surrogate of {config.channels} channels, {config.blocks} residual "
        f"block{blocks}, {config.epochs} epochs"
    )
    with Bar("learning", total=1) as bar:
        trials = try_surrogate(elites, config, chosen, bar)
    facts = scores_to_dict(elites, config, trials)
    skills = [("held out", "R2 (s.d.)", "RMSE (s.d.)", "rank correlation (s.d.)")]
    for one, score in facts["skills"].items():
        cells = _figure(score["r2"]), _figure(score["rmse"], ".3g"), _figure(score["rank"])
        skills.append((one, *cells))
    about = "R2: 1 is perfect, 0 no better than the mean of the elites held out"
    say(*format_table(skills), f"{about}; s.d. over the splits")
    if tiles := facts.get("repaired_tiles_predicted"):
        drawn = f"as drawn, without a surrogate: {facts['repaired_tiles_as_drawn']:.1%}"
        say(f"tiles of repaired layouts predicted: {tiles['mean']:.1%} ({drawn})")
    if table:
        columns = [f"{word}{one}" for one in elites.names for word in ("", "predicted ")]
        lines = []
        for trial in trials:
            for row, guess in zip(trial.held, trial.predicted, strict=True):
                pairs = np.stack([elites.numbers[row], guess], axis=1)
                cell = ",".join(map(str, elites.cells[row]))
                lines.append([trial.seed, cell, *(f"{one:.6g}" for one in pairs.flat)])
        write_csv(table.path, ["seed", "cell", *columns], lines)
    if picture:
        from qdenv.view.archive import draw_predictions  # imports matplotlib
        from qdenv.view.style import save_figure

        unit = {elites.names[0]: f" [{elites.units}]"} if elites.units else {}
        panels = {
            one + unit.get(one, ""): f"R2 {_figure(score['r2'])}, rank {_figure(score['rank'])}"
            for one, score in facts["skills"].items()
        }
        truth = np.concatenate([elites.numbers[trial.held] for trial in trials])
        predicted = np.concatenate([trial.predicted for trial in trials])
        title = f"{name}: {facts['held_out']} of {facts['elites']} elites held out, "
        title += f"{len(trials)} split{plural}"
        title += "; in brackets the standard deviation over them" * (len(trials) > 1)
        save_figure(draw_predictions(truth, predicted, panels, title), picture.path)
    say(*filter(None, [", ".join(str(one) for one in (table, picture) if one)]))
    return Result(facts | {"settings": {"run": str(run), "seeds": chosen}})


def _figure(figure: Mapping[str, Any], form: str = ".2f") -> str:
    """Write a mean and its spread, as far as they are known."""
    mean, spread = figure["mean"], figure["spread"]
    if np.isnan(mean):
        return "does not vary"
    return f"{mean:{form}}" + ("" if np.isnan(spread) else f" ({spread:{form}})")
