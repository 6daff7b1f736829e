"""Attack with bad files and command lines: each must end soon, in one line, with exit code 2."""

import contextlib
import functools
import importlib.util
import io
import json
import re
import shlex
import tempfile
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

from small_warehouse import ROWS as WAREHOUSE

from qdenv.cli.main import run as qdenv
from qdenv.domains.base import find_domain
from qdenv.io.formats import FORMATS, write_drawing
from qdenv.io.layouts import Drawing
from qdenv.simulation.maze.policy import SHIPPED_AGENT
from robustness.campaign import Attack, Attempt
from robustness.corrupt import Rng, corrupt, damage, hostile_checkpoint, pick
from robustness.sandbox import Sandbox

INPUTS = 50  # of one attempt
MAZE = ["      ", " XXXX ", "    X ", " XX X ", "  X   ", "X   X "]
PATHS = b"timestep,robot,row,column\n0,0,0,0\n1,0,0,1\n0,1,5,5\n1,1,5,5\n"
SEARCH = (  # a search of seconds, whose run commands read
    "train maze-quick --evaluations 8 --simulations 1 --timesteps 20 --rows 6 --cols 6 --steps 3 "
    "--hidden 4 --emitters 1 --batch 4 --archive 0 36 4 0 36 4 --out run"
)
AGENT = (  # two updates of an agent's training
    "train-agent --out run --steps 64 --units 4 --bank 8 --fresh 4 --exam 1 --ppo.lanes 4 "
    "--ppo.timesteps 8 --ppo.minibatches 1"
)
SHORT = "--agents 2 --timesteps 5"
# Name -> a command line that does next to nothing; capitals stand for a file or folder.
LINES: Mapping[str, str] = {
    "check": "check PLAN",
    "render": "render PLAN",
    "convert": "convert PLAN plan.csv",
    "simulate": f"simulate PLAN {SHORT} --seeds 1 --no-verdict",
    "replay": f"replay PLAN {SHORT}",
    "repair": "repair PLAN",
    "compare": f"compare PLAN {SHORT} --seeds 1",
    "sweep": f"sweep PLAN {SHORT} --seeds 1",
    "scalability": f"scalability PLAN {SHORT} --seeds 1",
    "report": "report MAZE --timesteps 5",
    "layout human": "layout human --rows 9 --cols 12",
    "layout tile": "layout tile PLAN --rows 12 --cols 22",
    "layout symbols": "layout symbols",
    "zoo": "zoo",
    "presets": "presets",
    "plot": "plot RUN --out pictures",
    "generate": "generate RUN",
    "export": "export RUN",
    "explore": "explore RUN --growth 0",
    "series": "series RUN --sizes 6x6",
    "surrogate": "surrogate RUN",
    "evaluate-agent": "evaluate-agent MAZE --runs 1",
    "convert-agent": "convert-agent MAZE",
    "completion": "completion bash",
    "audit-run": "audit-run PATHS --layout PLAN",
    # Refused at the end of all checks, as the folder holds a run already.
    "train": "train maze-quick --out RUN",
    "train-agent": "train-agent --out AGENT",
    "guide": "guide PLAN --out RUN",
    "improve": "improve PLAN --out RUN",
}
TRAINING = ("train", "train-agent", "guide", "improve")
# Options that are not drawn: in another folder these would train for hours, and the picture of
# the zoo takes longer than a bad input may.
EXCLUDED = dict.fromkeys(TRAINING, ("--out", "--run-dir")) | {"zoo": ("--plot",)}
EXTREMES = (
    *("-1", "0", "1", "0.5", "-0.0", "nan", "inf", "-inf", "1e308", "1e-320", "9" * 30, "9" * 5000),
    *("2147483648", "9223372036854775808", "18446744073709551616", "-2147483649", "", " ", "a"),
    *("\x1b[31m", "two\nlines", "\u00e9\u202e", "1:99999999999", "5:1", "1,1,1", "1,", "best"),
    *("a.png", "a.json", "a.csv", "a.html", ".", "..", "/", "/dev/null", "-", "--", "="),
    *("plan.json", "run", "nowhere/x.json", "None", "True", "auto", "zoo:moon", "zoo:maze-walls"),
    *("pbs", "pibt", "low"),
)


class Input(NamedTuple):
    """One bad input."""

    kind: str  # what it attacks
    argv: tuple[str, ...]  # the command line
    file: str = ""  # that is corrupt


@functools.cache
def sandbox() -> Sandbox:
    """Start the process that runs the command lines, once."""
    return Sandbox()


@functools.cache
def run_files(made_by: str = SEARCH) -> dict[str, bytes]:
    """Make a run directory, once, and return its files by name."""
    with tempfile.TemporaryDirectory(prefix="qdenv-robustness-") as folder:
        fault = sandbox().fault_of(made_by.split(), Path(folder), limited=False)
        assert fault is None, fault
        home = Path(folder) / "run"
        return {
            path.relative_to(home).as_posix(): path.read_bytes()
            for path in sorted(home.rglob("*"))
            if path.is_file() and path.suffix in (".json", ".csv", ".npz")
        }


def layout_file(rows: list[str], ending: str) -> bytes:
    """Return the content of a layout file."""
    if ending == ".json":
        return json.dumps({"n_row": len(rows), "layout": rows, "domain": "warehouse-even"}).encode()
    if ending == ".csv":
        rows = [",".join(row) for row in rows]
    head = [f"type octile\nheight {len(rows)}\nwidth {len(rows[0])}\nmap"] * (ending == ".map")
    return "\n".join([*head, *rows, ""]).encode()


LIBRARIES = {"xlsx": "openpyxl", "dxf": "ezdxf"}  # without them nothing is written
FORMS = tuple(
    (form, ending)
    for form, one in FORMATS.items()
    if one.read and (form not in LIBRARIES or importlib.util.find_spec(LIBRARIES[form]))
    for ending in one.endings
)


@functools.cache
def foreign_files(form: str, ending: str) -> dict[str, bytes]:
    """Write a warehouse with two robots in a format; return all its files by name."""
    meanings = find_domain("warehouse-even").meanings
    drawing = Drawing(WAREHOUSE, starts=(0, 5), tasks=((2, 4), (3,)), details={"cell": 1.2})
    with tempfile.TemporaryDirectory(prefix="qdenv-robustness-") as folder:
        write_drawing(Path(folder) / f"plan{ending}", drawing, meanings, form)
        return {path.name: path.read_bytes() for path in sorted(Path(folder).iterdir())}


def write(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write files into a folder."""
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)


def line(command: str, **files: str) -> tuple[str, ...]:
    """Return a command line with files in the places of its capitals."""
    return tuple(files.get(word, word) for word in LINES[command].split())


def corrupt_layout(rng: Rng, folder: Path) -> Input:
    """Corrupt a layout file of any format, or a file that it names."""
    form, ending = pick(rng, FORMS)
    files = foreign_files(form, ending)
    name = pick(rng, [*files])
    write(folder, files | {name: corrupt(rng, name, files[name])})
    command = pick(rng, ("check",) * 8 + ("render", "simulate", "repair", "sweep"))
    return Input("layouts", line(command, PLAN=f"plan{ending}"), name)


def corrupt_paths(rng: Rng, folder: Path) -> Input:
    """Corrupt a file of where robots were."""
    plan = layout_file(WAREHOUSE, ".json")
    write(folder, {"paths.csv": corrupt(rng, "paths.csv", PATHS), "plan.json": plan})
    return Input("paths", line("audit-run", PATHS="paths.csv", PLAN="plan.json"), "paths.csv")


def corrupt_run(rng: Rng, folder: Path) -> Input:
    """Corrupt one file of a run."""
    files = dict(run_files())
    name = pick(rng, [file for file in files if not file.startswith("checkpoints")])
    files[name] = corrupt(rng, name, files[name])
    write(folder / "run", files)
    command = pick(rng, ("export",) * 4 + ("plot", "plot", "generate", "explore"))
    return Input("run directories", line(command, RUN="run"), name)


def corrupt_checkpoints(rng: Rng, folder: Path) -> Input:
    """Corrupt all checkpoints of a run, and resume it."""
    files = dict(run_files())
    names = [file for file in files if file.startswith("checkpoints")]
    write(folder / "run", files | {name: corrupt(rng, name, files[name]) for name in names})
    return Input("checkpoints", ("resume", "run"), "checkpoints")


def corrupt_training(rng: Rng, folder: Path) -> Input:
    """Corrupt the checkpoint of an agent's training, and resume it."""
    files, name = run_files(AGENT), "checkpoint.npz"
    write(folder / "run", files | {name: corrupt(rng, name, files[name])})
    return Input("checkpoints", ("resume", "run"), f"an agent's {name}")


def corrupt_agent(rng: Rng, folder: Path) -> Input:
    agent = corrupt(rng, "a.npz", SHIPPED_AGENT.read_bytes())
    write(folder, {"a.npz": agent, "maze.txt": layout_file(MAZE, ".txt")})
    argv = (*line("evaluate-agent", MAZE="maze.txt"), "--agent", "a.npz")
    return Input("agents", argv, "a.npz")


def hostile_pickle(rng: Rng, folder: Path) -> Input:
    content = hostile_checkpoint(rng)
    content = damage(rng, content) if rng.random() < 0.3 else content
    write(folder, {"m.tar": content})
    return Input("pickles", ("convert-agent", "m.tar"), "m.tar")


def bad_file(rng: Rng, folder: Path) -> Input:
    """Draw a bad file of any kind; those that cost seconds are the fewest."""
    kinds = [corrupt_layout] * 8 + [hostile_pickle] * 8 + [corrupt_run] * 6
    kinds += [corrupt_paths] * 2
    kinds += [corrupt_agent] * 3 + [corrupt_checkpoints, corrupt_training]
    draw: Callable[[Rng, Path], Input] = pick(rng, kinds)
    return draw(rng, folder)


@functools.cache
def options_of(command: str) -> tuple[str, ...]:
    """Return the options that the help of a command lists."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.suppress(SystemExit):
        qdenv([*LINES[command].split()[: len(command.split())], "--help"])
    options = re.findall(r"^\W*(--[a-z][a-z0-9.-]*)", out.getvalue(), re.MULTILINE)
    return tuple(sorted(set(options)))


def bad_line(rng: Rng, folder: Path) -> Input:
    """Draw options with extreme values for a command that would do next to nothing."""
    plan, maze = layout_file(WAREHOUSE, ".json"), layout_file(MAZE, ".txt")
    write(folder, {"plan.json": plan, "maze.txt": maze, "paths.csv": PATHS})
    write(folder / "run", run_files())
    write(folder / "agent", {"checkpoint.npz": b"", "config.json": b"{}"})
    command = pick(rng, tuple(LINES))
    files = {"PLAN": "plan.json", "MAZE": "maze.txt", "RUN": "run", "AGENT": "agent"}
    files["PATHS"] = "paths.csv"
    excluded = EXCLUDED.get(command, ())
    options = tuple(option for option in options_of(command) if option not in excluded)
    if command not in TRAINING and rng.random() < 0.2:
        files[pick(rng, tuple(files))] = pick(rng, EXTREMES)
    argv = list(line(command, **files))
    for _ in range(int(rng.integers(1, 4))):
        argv.append(pick(rng, (*options, "--unknown")))
        argv += [pick(rng, EXTREMES) for _ in range(pick(rng, (0, 1, 1, 1, 1, 2, 6)))]
    return Input(command, tuple(argv))


def attempt(
    draw: Callable[[Rng, Path], Input], rng: Rng, folder: Path, inputs: int = INPUTS
) -> Attempt:
    """Try some inputs, each in a folder of its own."""
    kinds, faults = Counter[str](), []
    for number in range(inputs):
        place = folder / str(number)
        place.mkdir()
        bad = draw(rng, place)
        kinds[bad.kind] += 1
        if fault := sandbox().fault_of(bad.argv, place):
            shown = shlex.join(word[:60] for word in bad.argv)
            faults.append(f"input {number}, `qdenv {shown}` ({bad.file or bad.kind}): {fault}")
    return Attempt(inputs, faults, kinds)


PROMISE = "one line and exit code 2, within 10 s and 1 GB"
FILES = Attack("files", PROMISE, "files", functools.partial(attempt, bad_file))
COMMANDS = Attack("commands", PROMISE, "lines", functools.partial(attempt, bad_line))
