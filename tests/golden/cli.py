"""Command lines: what each prints, answers and writes, mistakes as well."""

import atexit
import contextlib
import csv
import io
import json
import os
import re
import shlex
import shutil
import sys
import tempfile
from contextlib import redirect_stderr, redirect_stdout
from itertools import islice
from pathlib import Path
from typing import Any

import cli_cases
import numpy as np
import pages
from record import sha

PART = (1, 5)
FLOATS = True  # searches and generators of the zoo
PICTURES = (".png", ".svg", ".pdf", ".gif", ".mp4")
LONG = 3000  # characters of JSON from which on a list or a file is hashed
# Facts of the machine, the moment and the installation.
VOLATILE = re.compile(
    r"^(qdenv|versions|created|machine|device|git_revision|takes|megabytes|.*seconds(?!_per_step).*)$"
)
PLACEHOLDERS = {
    r"\d{4}-?\d\d-?\d\d[T -]\d\d:?\d\d:?\d\d[+:\d]*": "DATE",
    r"[\d.]+(e-\d+)? (CPU s|MB)\b": r"# \2",
    r"\bin [\d.]+ s\b": "in # s",
    r"\babout [\d.]+\s+(s|min|h|days)\b( \((an estimate|as measured here)\))?": "about #",
    r"(cpu_seconds +)[\d.]+": r"\1#",
    r"\bqdenv \d+\.\d+\.\d+\S*": "qdenv VERSION",
}
_made = Path(tempfile.mkdtemp("-golden"))  # inputs that are made once per process
atexit.register(shutil.rmtree, _made, ignore_errors=True)


def CASES() -> list[str]:  # noqa: N802 (what record.py reads)
    """Return all cases: every fifth is a cheap one, for the test suite."""
    quick = re.compile("check|layout symbols|presets$|zoo$")
    costly, cheap = cli_cases.COSTLY, cli_cases.CHEAP
    tested = cheap[::4] + [case for case in costly if quick.match(case)]
    rest = iter([case for case in costly + cheap if case not in tested])
    cases = [one for case in tested for one in (next(rest), case, *islice(rest, 3))]
    return cases + list(rest)


def run(case: str) -> Any:
    """Run the commands of a case, with " ; " between them, in a folder of its own."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name).resolve()
        for path, text in cli_cases.FILES.items():
            (folder / path).parent.mkdir(exist_ok=True)
            (folder / path).write_text(text, "utf-8")
        for made in sorted(set(re.findall(r"\b(?:run|run2|mazes)\b", case))):
            shutil.copytree(_run(made), folder / made)
        return [_answer(expand(line), folder) for line in case.split(" ; ")]


def expand(line: str) -> list[str]:
    """Split a command line into arguments and expand the macros."""
    for name, value in cli_cases.MACROS.items():
        line = line.replace(name, value)
    return shlex.split(line)


def _run(name: str) -> Path:
    """Return the folder of a small search, made at its first use."""
    if not (_made / name).exists():
        result = call([*expand(cli_cases.RUNS[name]), "--out", name], _made)
        assert result["code"] == 0, result
    return _made / name


def call(argv: list[str], folder: Path) -> dict[str, Any]:
    """Run `qdenv` in a folder; return its exit code and what it printed."""
    from qdenv.cli.main import run as qdenv

    out, err = io.StringIO(), io.StringIO()
    root = str(Path(__file__).parents[2])
    environment = {
        "COLUMNS": "80",
        "PYTHONPATH": os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH")])),
    }
    before, argv_before, cpus = dict(os.environ), sys.argv, os.cpu_count
    os.environ.update(environment)
    sys.argv, os.cpu_count = ["qdenv", *argv], lambda: 2  # estimates of time depend on it
    try:
        with contextlib.chdir(folder), redirect_stdout(out), redirect_stderr(err):
            code: Any = qdenv(argv)
    except SystemExit as stop:
        code = stop.code or 0
    except Exception as error:
        code = f"raised {type(error).__name__}: {error}"
    finally:
        os.environ.clear()
        os.environ.update(before)
        sys.argv, os.cpu_count = argv_before, cpus
    return {"code": code, "out": out.getvalue(), "err": err.getvalue()}


def _answer(argv: list[str], folder: Path) -> dict[str, Any]:
    """Return exit code, texts and files of one command, without what differs by itself."""
    before = _state(folder)
    answer = call(argv, folder)
    out = answer["out"]
    if {"--help", "--help-all", "help"} & set(argv) or not argv:
        answer["out"] = about_help(out)
    elif argv[0] == "completion" and answer["code"] == 0:
        answer["out"] = about_completion(out)
    elif argv == ["--version"]:
        assert re.fullmatch(r"\d+\.\d+\.\d+\S*\n", out)
        answer["out"] = "VERSION"
    elif "--json -" in " ".join(argv) and answer["code"] in (0, 1):
        answer["out"] = clean(json.loads(out), folder)
    else:
        answer["out"] = normal(out, folder)
    answer["err"] = normal(answer["err"], folder)
    after = _state(folder)
    written = [path for path in after if after[path] != before.get(path)]
    answer["files"] = {
        normal(path, folder): content(folder / path, folder) for path in sorted(written)
    }
    answer["gone"] = sorted(before.keys() - after.keys())
    return {key: value for key, value in answer.items() if value not in ({}, [], "")}


def _state(folder: Path) -> dict[str, bytes]:
    files = (path for path in folder.rglob("*") if path.is_file() and path.name[0] != ".")
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def normal(text: str, folder: Path) -> str:
    """Replace what differs between two calls or two machines by placeholders."""
    for place in {str(folder), str(folder.resolve()), str(_made)}:
        text = text.replace(place, "TMP")
    text = text.replace(str(Path(__file__).parents[2]), "ROOT")
    for pattern, placeholder in PLACEHOLDERS.items():
        text = re.sub(pattern, placeholder, text)
    return re.sub(r"(?m) +$", "", text)


def clean(value: Any, folder: Path) -> Any:
    """Reduce JSON: volatile facts are left out, layouts and long lists hashed."""
    if isinstance(value, dict):
        return {
            key: sha("\n".join(one)) if key == "layout" and isinstance(one, list) else one
            for key, one in ((k, clean(v, folder)) for k, v in value.items())
            if not VOLATILE.match(key)
        }
    if isinstance(value, list):
        value = [clean(one, folder) for one in value]
        text = json.dumps(value)
        return sha(text) if len(text) > LONG else value
    return normal(value, folder) if isinstance(value, str) else value


def content(path: Path, folder: Path) -> Any:
    """Return what a file holds: JSON's values, hashes of data, pictures by their name alone."""
    if path.suffix in PICTURES:
        assert path.stat().st_size
        return "written"
    if path.suffix == ".html":
        return pages.digest(path, folder)
    if path.suffix == ".json":
        value = clean(json.loads(path.read_text("utf-8")), folder)
        text = json.dumps(value, sort_keys=True)
        return value if len(text) <= LONG else sha(text)
    if path.suffix == ".npz":
        with np.load(path, allow_pickle=False) as arrays:
            return sha(json.dumps({k: _array(k, arrays[k], folder) for k in sorted(arrays.files)}))
    if path.suffix == ".parquet":
        import pandas

        return sha(pandas.read_parquet(path).to_csv())
    text = path.read_text("utf-8")
    if path.suffix == ".jsonl":
        return [clean(json.loads(line), folder) for line in text.splitlines()]
    if path.suffix == ".csv":
        rows = list(csv.reader(text.splitlines()))
        keep = [i for i, name in enumerate(rows[0]) if not VOLATILE.match(name)]
        if len(keep) < len(rows[0]):
            text = "\n".join(",".join(row[i] for i in keep) for row in rows)
    text = normal(text, folder)
    return text if len(text) <= LONG else sha(text)


def _array(name: str, array: np.ndarray, folder: Path) -> str:
    """Hash an array; one that holds JSON (as bytes or text) without its volatile facts."""
    if VOLATILE.match(name):
        return ""
    with contextlib.suppress(ValueError, UnicodeDecodeError):
        raw = array.tobytes() if array.dtype == np.uint8 else str(array[()]).encode()
        if raw[:1] == b"{":
            return sha(json.dumps(clean(json.loads(raw), folder), sort_keys=True))
    return sha(array)


def about_help(text: str) -> Any:
    """Return help: the options with their defaults, and the text without digits.

    Wrapping and wording may change; the names of options and their defaults are the interface.
    """
    plain = " ".join(re.sub(r"[│╭╮╰╯─]+", " ", text).split())
    options = re.findall(r"(--[a-z][\w.-]*)", plain)
    parts = re.split(r"(?= --[a-z][\w.-]*(?: [\[{A-Z]|,))", plain)
    defaults = {}
    for part in parts:
        name, default = re.match(r" (--[\w.-]+)", part), re.search(r"\(default: (.*?)\)", part)
        if name and default and "(an estimate)" not in part:
            defaults.setdefault(name[1], default[1])
    return {
        "options": " ".join(dict.fromkeys(options)),
        "defaults": defaults,
        "text": re.sub(r"\d+(\.\d+)?", "#", "\n".join(line.rstrip() for line in text.split("\n"))),
    }


def about_completion(text: str) -> Any:
    """Return the options that a completion script knows, by command."""
    import ast

    found = re.search(r"^COMPLETION_SPEC = (\{.*\})$", text, re.M)
    assert found, text[:500]

    def options(spec: dict[str, Any]) -> dict[str, Any]:
        names = sorted(one for option in spec["options"] for one in option["flags"])
        inner = {k: options(v) for k, v in spec["subcommands"].items() if " " not in k}
        if len(inner) > 20 and names:  # presets, which have the options of their command
            inner = " ".join(inner)
        return {"options": " ".join(names), "commands": inner}

    return options(ast.literal_eval(found[1]))
