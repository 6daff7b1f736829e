"""Bad inputs, thousands of them: each must end soon, in one line, with exit code 2."""

import contextlib
import functools
import io
import json
import re
import shlex
import tempfile
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

from qdenv.io.layouts import ENDINGS
from qdenv.simulate.maze.policy import shipped_agent
from robustness.attack import Attack, Attempt
from robustness.damage import Chance, damaged, pick, spoilt
from robustness.hostile import checkpoint
from robustness.judge import Judge
from robustness.lines import EXTREMES, LINES, PLACES, SEARCH, TRAINED, TRAINING

INPUTS = 50  # of one attempt
WAREHOUSE = [
    "...........",
    "w..@e.e@..w",
    "...@e.e@...",
    "...........",
    "w..e@.@e..w",
    "...........",
]
MAZE = ["      ", " XXXX ", "    X ", " XX X ", "  X   ", "X   X "]


class Input(NamedTuple):
    """One bad input."""

    kind: str  # what it attacks
    argv: tuple[str, ...]  # the command line
    about: str = ""  # what is wrong with it, for the message


@functools.cache
def judge() -> Judge:
    """Start the process that runs the command lines, once."""
    return Judge()


@functools.cache
def run_files(made_by: tuple[str, ...] = SEARCH) -> dict[str, bytes]:
    """Make a run directory, once: its files by name."""
    with tempfile.TemporaryDirectory(prefix="qdenv-robustness-") as folder:
        fault = judge().fault_of(made_by, Path(folder), limited=False)
        assert fault is None, fault
        home = Path(folder) / "run"
        return {
            path.relative_to(home).as_posix(): path.read_bytes()
            for path in sorted(home.rglob("*"))
            if path.is_file() and path.suffix in (".json", ".csv", ".npz")
        }


def drawing(rows: list[str], ending: str) -> bytes:
    """Write a layout file."""
    if ending == ".json":
        return json.dumps({"n_row": len(rows), "layout": rows, "domain": "warehouse-even"}).encode()
    cells = {".csv": [",".join(row) for row in rows], ".txt": rows, ".map": rows}[ending]
    head = [f"type octile\nheight {len(rows)}\nwidth {len(rows[0])}\nmap"] * (ending == ".map")
    return "\n".join([*head, *cells, ""]).encode()


def save(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write files into a folder."""
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)


def layout(chance: Chance, folder: Path) -> Input:
    """Damage a layout file and ask for something of it."""
    ending = pick(chance, ENDINGS)
    name = f"plan{ending}"
    save(folder, {name: spoilt(chance, name, drawing(WAREHOUSE, ending))})
    command = pick(chance, ("check",) * 8 + ("render", "simulate", "repair", "sweep"))
    return Input("layouts", placed(LINES[command], {"PLAN": name}), name)


def run_directory(chance: Chance, folder: Path) -> Input:
    """Damage one file of a run and ask for something of the run."""
    files = dict(run_files())
    name = pick(chance, [one for one in files if not one.startswith("checkpoints")])
    files[name] = spoilt(chance, name, files[name])
    save(folder / "run", files)
    command = pick(chance, ("export",) * 4 + ("plot", "plot", "generate", "explore"))
    return Input("run directories", placed(LINES[command], {"RUN": "run"}), name)


def checkpoints(chance: Chance, folder: Path) -> Input:
    """Damage all checkpoints of a run, and go on from them."""
    files = dict(run_files())
    names = [one for one in files if one.startswith("checkpoints")]
    save(folder / "run", files | {one: spoilt(chance, one, files[one]) for one in names})
    return Input("checkpoints", ("resume", "run"), "checkpoints")


def trained_agent(chance: Chance, folder: Path) -> Input:
    """Damage the checkpoint of an agent's training, and go on from it."""
    files, name = run_files(TRAINED), "checkpoint.npz"
    save(folder / "run", files | {name: spoilt(chance, name, files[name])})
    return Input("checkpoints", ("resume", "run"), f"an agent's {name}")


def agent(chance: Chance, folder: Path) -> Input:
    """Damage an agent and let it walk."""
    whole = shipped_agent().read_bytes()
    save(folder, {"a.npz": spoilt(chance, "a.npz", whole), "maze.txt": drawing(MAZE, ".txt")})
    words = placed(LINES["evaluate-agent"], {"MAZE": "maze.txt"})
    return Input("agents", (*words, "--agent", "a.npz"), "a.npz")


def foreign(chance: Chance, folder: Path) -> Input:
    """Convert a checkpoint that means harm."""
    content = checkpoint(chance)
    content = damaged(chance, content) if chance.random() < 0.3 else content
    save(folder, {"m.tar": content})
    return Input("pickles", ("convert-agent", "m.tar"), "m.tar")


@functools.cache
def options_of(command: str) -> tuple[str, ...]:
    """List the options of a command, as its own help does."""
    from qdenv.cli import run  # imports the parser

    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.suppress(SystemExit):
        run([*LINES[command][: len(command.split())], "--help"])
    return tuple(
        sorted(set(re.findall(r"^\W*(--[a-z][a-z0-9.-]*)", said.getvalue(), re.MULTILINE)))
    )


def placed(words: tuple[str, ...], places: Mapping[str, str]) -> tuple[str, ...]:
    """Put files in the places of words in capitals."""
    return tuple(places.get(word, word) for word in words)


def command_line(chance: Chance, folder: Path) -> Input:
    """Draw options with extreme values for a command that would do next to nothing."""
    save(folder, {"plan.json": drawing(WAREHOUSE, ".json"), "maze.txt": drawing(MAZE, ".txt")})
    save(folder / "run", run_files())
    save(folder / "agent", {"checkpoint.npz": b"", "config.json": b"{}"})
    command = pick(chance, tuple(LINES))
    files = {"PLAN": "plan.json", "MAZE": "maze.txt", "RUN": "run", "AGENT": "agent"}
    known = options_of(command)
    if command in TRAINING:
        known = tuple(option for option in known if option not in PLACES)
    elif chance.random() < 0.2:
        files[pick(chance, tuple(files))] = pick(chance, EXTREMES)
    words = list(placed(LINES[command], files))
    for _ in range(int(chance.integers(1, 4))):
        words.append(pick(chance, (*known, "--unknown")))
        words += [pick(chance, EXTREMES) for _ in range(pick(chance, (0, 1, 1, 1, 1, 2, 6)))]
    return Input(command, tuple(words))


def attempt(
    draw: Callable[[Chance, Path], Input], chance: Chance, folder: Path, inputs: int = INPUTS
) -> Attempt:
    """Try some inputs, each in a folder of its own."""
    kinds, faults = Counter[str](), []
    for number in range(inputs):
        place = folder / str(number)
        place.mkdir()
        one = draw(chance, place)
        kinds[one.kind] += 1
        fault = judge().fault_of(one.argv, place)
        if fault:
            shown = shlex.join(word[:60] for word in one.argv)
            faults.append(f"input {number}, `qdenv {shown}` ({one.about or one.kind}): {fault}")
    return Attempt(inputs, tuple(faults), dict(kinds))


def bad_file(chance: Chance, folder: Path) -> Input:
    """Draw a bad file of any kind; those that cost seconds are the fewest."""
    draws = (layout,) * 8 + (foreign,) * 8 + (run_directory,) * 6 + (agent,) * 3
    return pick(chance, (*draws, checkpoints, trained_agent))(chance, folder)


PROMISE = "one line and exit code 2, within 10 s and 1 GB"
FILES = Attack("files", PROMISE, "files", functools.partial(attempt, bad_file))
COMMANDS = Attack("commands", PROMISE, "lines", functools.partial(attempt, command_line))
