"""What all commands about traffic say alike: who drives, in which units, where pictures go."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, Any

import tyro

from qdenv.commands import output
from qdenv.commands.choices import FleetOptions
from qdenv.simulate.mapf.choosing import describe_planner, record_planner
from qdenv.study.plans import Plan
from qdenv.types import InputError
from qdenv.view.widths import parse_width

AUTO = Path("auto")  # what `--plot` without a name is turned into
SECONDS_PER_HOUR = 3600

# How a command takes `--plot`, with a name or without.
Picture = Annotated[Path | None, tyro.conf.arg(metavar="[FILE]")]

# How a command takes the width of its picture; `parse_width` reads it.
Width = Annotated[str | None, tyro.conf.arg(metavar="{column,page,INCHES}")]


def place_picture(
    plot: Path | None,
    default: str,
    inputs: Iterable[Path],
    endings: Iterable[str] = output.PICTURES,
) -> output.Place | None:
    """Choose where a picture goes; None where none is asked for.

    Raises:
        InputError: see `output.place`.
    """
    if plot is None:
        return None
    return output.place(None if plot == AUTO else plot, default, endings, inputs)


def inches(width: str | None, pictured: bool = True) -> dict[str, float]:
    """Read the width of a picture, as the argument of what draws it; none where nobody says it.

    Raises:
        InputError: it is none, or there is no picture.
    """
    if width is None:
        return {}
    if not pictured:
        raise InputError(f"--width {width} is the picture's: add --plot")
    return {"width": parse_width(width)}


def steps_per_hour(options: FleetOptions) -> float | None:
    """Turn the length of a timestep into timesteps per hour; None where it is not said."""
    seconds = options.seconds_per_step
    if seconds is None:
        return None
    return SECONDS_PER_HOUR / seconds


def describe_study(agents: str, options: FleetOptions, seeds: Sequence[int], plan: Plan) -> str:
    """Say in one line what is simulated."""
    planner = describe_planner(options.planner_settings)
    runs = f"{len(seeds)} seeds" if len(seeds) > 1 else "1 seed"
    end = "" if options.stop else ", no stop at congestion"
    return (
        f"{agents} agents, {options.timesteps} timesteps{end}, {runs}, {plan.whose}; "
        f"planner: {planner}"
    )


def settings_of(options: FleetOptions, seeds: Sequence[int]) -> dict[str, Any]:
    """List the settings of a study for its facts."""
    return {
        "domain": options.domain,
        "timesteps": options.timesteps,
        "seeds": list(seeds),
        "effort": options.effort,
        "planner": record_planner(options.planner_settings),
        "stop": options.stop,
        "seconds_per_step": options.seconds_per_step,
    }
