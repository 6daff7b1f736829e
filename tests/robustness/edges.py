"""Attack at the edges: permissions, full disks, caches, streams, commands side by side, names."""

import json
import re
import subprocess
from collections import Counter
from collections.abc import Callable, Sequence
from html.parser import HTMLParser
from pathlib import Path

import qdenv
from qdenv.io.files import TEMPORARY_PREFIX
from robustness.campaign import Attack, Attempt
from robustness.corrupt import Rng, damage, pick
from robustness.inputs import (
    MAZE,
    TRAINING,
    WAREHOUSE,
    layout_file,
    line,
    run_files,
    sandbox,
    write,
)
from robustness.sandbox import BECOME_ORDINARY, Ending, fault_in, start

PLAN, NOTED = "plan.json", "old\n"
CHEAP = ("check", "render", "layout human", "layout symbols", "presets", "zoo", "export")
# Parts of names of files, and of what a foreign run calls its measures.
HOSTILE = (
    "$",
    "$\\bad$",
    "<",
    "&lt;",
    "'",
    '"',
    "\n",
    "\x1b[31m",
    "\udcff",
    "\u202e",
    " ",
    "%s",
    "#",
)
SCRIPT = "</p></script><img src=x onerror=alert(1)>"
# A function compiled as the package's are, and what is left of it.
KERNEL = """
import logging
logging.basicConfig()
from qdenv import native
@native.compiled
def double(number):
    return 2 * number
print(double(21))
"""


def files(folder: Path) -> None:
    """Write a plan, a maze and a run into a folder."""
    write(folder, {PLAN: layout_file(WAREHOUSE, ".json"), "maze.txt": layout_file(MAZE, ".txt")})
    write(folder / "run", run_files())


def faults_of(process: subprocess.Popen) -> list[str]:
    """Wait for a command and return the promise that it broke."""
    _, stderr = process.communicate(timeout=300)
    error = stderr if "Traceback" in stderr else ""
    fault = fault_in(Ending(process.returncode, error, stderr, [], 0.0))
    return [fault] if fault else []


def lock(rng: Rng, folder: Path) -> list[str]:
    """Read and write where an ordinary user may not."""
    inside = folder / "locked"
    files(inside)
    write(inside / "agent", {"checkpoint.npz": b"", "config.json": b"{}"})
    (folder / PLAN).write_bytes(layout_file(WAREHOUSE, ".json"))
    names = {"PLAN": PLAN, "MAZE": "maze.txt", "RUN": "run", "AGENT": "agent"}
    command = pick(rng, tuple(name for name in CHEAP if "zoo" not in name) + TRAINING)
    argv = list(line(command, **{word: f"locked/{name}" for word, name in names.items()}))
    if command not in TRAINING and rng.random() < 0.5:
        argv += ["--json", "locked/facts.json"]
    closed = pick(rng, (inside, inside / PLAN, inside / "run", inside / "run" / "config.json"))
    before = closed.stat().st_mode
    closed.chmod(pick(rng, (0o000, 0o111, 0o444, 0o555) if closed.is_dir() else (0, 0o222)))
    try:
        fault = sandbox().fault_of(argv, folder)
    finally:
        closed.chmod(before)
    return [f"`qdenv {' '.join(argv)}`, {closed.name} is closed: {fault}"] if fault else []


def fill(rng: Rng, folder: Path) -> list[str]:
    """Write to a full disk, and to a full standard output."""
    files(folder)
    argv = [*line(pick(rng, CHEAP), PLAN=PLAN, RUN="run"), "--json", "facts.json"]
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    most = int(rng.integers(0, 3000))
    limit = f"import resource; resource.setrlimit(resource.RLIMIT_FSIZE, ({most}, {most}))"
    with open("/dev/full", "w") as full:
        prepare, streams = (limit, {}) if rng.random() < 0.7 else ("0", {"stdout": full})
        faults = faults_of(start(["-m", "qdenv", *argv], folder, prepare, **streams))
    faults += [f"{path.name} was changed" for path in before if path.read_bytes() != before[path]]
    faults += [f"{path} was left behind" for path in folder.rglob(f"{TEMPORARY_PREFIX}*")]
    return [f"`qdenv {' '.join(argv)}`, {prepare}: {fault}" for fault in faults]


def spoil_cache(rng: Rng, folder: Path) -> list[str]:
    """Compile with a cache that is full, damaged, closed, or a file."""
    (folder / "kernel.py").write_text(KERNEL)
    cache, kind = folder / "cache", pick(rng, ("full", "damaged", "closed", "file"))
    prepare = f"os.environ['NUMBA_CACHE_DIR'] = {str(cache)!r}; {BECOME_ORDINARY}"
    if kind == "damaged":
        start(["kernel.py"], folder, prepare).communicate()
        for path in (one for one in cache.rglob("*") if one.is_file()):
            path.write_bytes(damage(rng, path.read_bytes()))
    elif kind == "closed":
        cache.mkdir(mode=0o555)
    elif kind == "file":
        cache.touch()
    else:
        prepare += "; import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (99, 99))"
    process = start(["kernel.py"], folder, prepare)
    stdout, stderr = process.communicate()
    lines = stderr.splitlines()
    # Full or closed: one line that says which folder.
    fine = not lines if kind == "damaged" else len(lines) == 1 and str(cache) in stderr
    good = process.returncode == 0 and stdout == "42\n" and fine
    return [] if good else [f"cache {kind}: {stdout!r}, {stderr[-300:]!r}"]


def redirect(rng: Rng, folder: Path) -> list[str]:
    """Close streams, read one line only, and write facts into a log by the name of the stream."""
    files(folder)
    argv = ["-m", "qdenv", *line(pick(rng, CHEAP), PLAN=PLAN, RUN="run")]
    kind = pick(rng, ("closed", "head", "log"))
    if kind == "closed":
        stream = int(rng.integers(3))
        process = start(argv, folder, f"os.close({stream})")
        if stream < 2:
            return [f"{argv}, stream {stream} is closed: {one}" for one in faults_of(process)]
        process.communicate(timeout=300)  # a refusal's line goes nowhere: its exit code remains
        good = process.returncode in (0, 2)
        return [] if good else [f"{argv}, stderr is closed: exit code {process.returncode}"]
    if kind == "head":
        process = start(argv, folder)
        process.stdout.readline()  # type: ignore[union-attr]
        process.stdout.close()  # type: ignore[union-attr]
        process.wait(timeout=300)
        stderr = process.stderr.read()  # type: ignore[union-attr]
        good = process.returncode in (0, 2) and "Traceback" not in stderr
        return [] if good else [f"{argv} | head -1: {stderr[-300:]!r}"]
    log, name = folder / "log", pick(rng, ("-", "/dev/stdout", "/dev/fd/1", "/proc/self/fd/1"))
    log.write_text(NOTED)
    with log.open("a") as out:
        faults = faults_of(start([*argv, "--json", name], folder, stdout=out))
    text = log.read_text()
    if not text.startswith(NOTED) or not re.search(r'"command": ".*"', text):
        faults.append(f"{argv} --json {name} >> log: {text[:200]!r}")
    return faults


def run_together(rng: Rng, folder: Path) -> list[str]:
    """Run one command twice at once: both results must be there, under two names."""
    files(folder)
    command = pick(rng, ("render", "layout human", "layout human", "export", "export"))
    argv = [*line(command, PLAN=PLAN, RUN="run")]
    ordinary = start(["-m", "qdenv", *argv], folder), start(["-m", "qdenv", *argv], folder)
    outputs = [process.communicate(timeout=300) for process in ordinary]
    if any(process.returncode for process in ordinary):
        return [f"twice `qdenv {' '.join(argv)}`: {outputs}"]
    named = [
        {word for word in re.split(r"[\s:,]+", out) if (folder / word).is_file()}
        for out, _ in outputs
    ]
    lost = [name for name in set.union(*named) if not (folder / name).stat().st_size]
    if not all(named) or named[0] & named[1] or lost:
        return [f"twice `qdenv {' '.join(argv)}`: results {named}, empty {lost}"]
    return []


class Scripts(HTMLParser):
    """Counts what a page would run that came from a name."""

    count = 0

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        """Count an image with our script."""
        self.count += ("onerror", "alert(1)") in attributes


def runs_script(text: str) -> bool:
    """Return True if a page, or a card of a notebook, runs the script of a name."""
    scripts = Scripts()
    scripts.feed(text)
    return scripts.count > 0


def name(rng: Rng, folder: Path) -> list[str]:
    """Give a file, or the measures of a foreign run, a name that is something else as well."""
    files(folder)
    parts = [pick(rng, HOSTILE) for _ in range(int(rng.integers(1, 6)))]
    cards, place = "", folder / "run" / "manifest.json"
    if rng.random() < 0.6:
        stem = "".join(parts) + SCRIPT.replace("/", "") * int(rng.integers(2))
        command, plan = pick(rng, ("check", "render", "replay", "convert")), f"{stem}.json"
        (folder / PLAN).rename(folder / plan)
        argv: Sequence[str] = line(command, PLAN=plan)
    else:
        manifest = json.loads(place.read_text())
        for axis in manifest["measures"]:
            axis["name"] += "".join(one for one in parts if one.isprintable()) + SCRIPT
        manifest["objective"] = SCRIPT
        place.write_text(json.dumps(manifest))
        argv = line(pick(rng, ("explore", "plot")), RUN="run")
        run = qdenv.RunDirectory.open(folder / "run")
        try:
            cards = run._repr_html_() + run.best._repr_html_()
        except qdenv.InputError:
            cards = ""
    fault = sandbox().fault_of(argv, folder)
    faults = [f"`qdenv {argv!r}`: {fault}"] if fault else []
    pages = {path.name: path.read_text() for path in folder.glob("*.html")} | {"card": cards}
    return faults + [
        f"{argv!r}: {page!a} runs a script" for page in pages if runs_script(pages[page])
    ]


Kind = Callable[[Rng, Path], list[str]]
# Those in a process of their own take seconds.
KINDS: dict[str, tuple[Kind, int]] = {
    "permissions": (lock, 8),
    "names": (name, 6),
    "full disks": (fill, 2),
    "streams": (redirect, 2),
    "side by side": (run_together, 2),
    "caches": (spoil_cache, 1),
}


def attempt(rng: Rng, folder: Path, kind: str = "") -> Attempt:
    """Try a few edges of all kinds, or of one, each in a folder of its own."""
    drawn = [kind] if kind else [one for one, (_, often) in KINDS.items() for _ in range(often)]
    kinds, faults = Counter[str](), []
    for number in range(4):
        place = folder / str(number)
        place.mkdir()
        one = pick(rng, drawn)
        kinds[one] += 1
        faults += [f"{one}: {fault!a}" for fault in KINDS[one][0](rng, place)]
    return Attempt(sum(kinds.values()), faults, kinds)


EDGES = Attack(
    "edges",
    "what the system refuses is one line, no result is lost, no name is anything but text",
    "edges",
    attempt,
    tuple(KINDS),
)
