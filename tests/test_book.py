"""The book: it builds without a warning, has every public name and command, and its code runs."""

import ast
import inspect
import pkgutil
import re
import runpy
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

import qdenv
from qdenv.cli import main as cli
from qdenv.cli.main import COMMANDS
from qdenv.domains.base import DOMAINS
from qdenv.search.registry import ALGORITHMS
from qdenv.simulation.mapf.settings import PLANNERS

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "notebooks").rglob("*.md"))]
# A block of code, and whether it takes long: then it is parsed, and not run.
BLOCK = re.compile(r"(<!-- long -->.*\n)?```(bash|python)\n(.*?)^```", re.DOTALL | re.MULTILINE)
BLOCKS = [
    pytest.param(bool(long), kind, code, id=f"{page.stem}-{number}")
    for page in PAGES
    for number, (long, kind, code) in enumerate(BLOCK.findall(page.read_text()))
]


def command_lines(code: str) -> list[list[str]]:
    """List the calls of qdenv in a block of bash, each as its words behind that name."""
    lines = code.replace("<(", "\n").replace(")\n", "\n").splitlines()
    calls = [shlex.split(one, comments=True) for line in lines for one in line.split("&&")]
    found = [words for words in calls if words and words[0].rpartition("/")[2] == "qdenv"]
    return [words[1 : words.index(">") if ">" in words else None] for words in found]


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A folder with the plan and the drawing of the page on layout files; the orchard is known."""
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "notebooks" / "how_to" / "layout_files.md").read_text()
    rows = [row.split() for row in page.partition("```\n")[2].partition("```")[0].splitlines()]
    for column, name in enumerate(("plan.txt", "keep.txt")):
        Path(name).write_text("\n".join(row[column] for row in rows))
    orchard = runpy.run_path(str(ROOT / "tests" / "plugin" / "orchard.py"))
    for registry, name in ((DOMAINS, "orchard"), (PLANNERS, "turns"), (ALGORITHMS, "mutate-best")):
        entry = orchard[name.upper().replace("-", "_")]
        monkeypatch.setitem(registry._entries, name, entry)


@pytest.mark.slow
@pytest.mark.parametrize(("long", "kind", "code"), BLOCKS)
def test_every_block_of_code_runs_or_is_parsed_where_it_takes_long(long, kind, code, place):
    if kind == "bash":
        for words in command_lines(code):
            cli.parse_command(*cli.split_name(words))  # refuses what no command understands
            assert long or cli.run(words) == 0
        return
    tree = ast.parse(code)
    for node in ast.walk(tree):  # public names, and arguments that they have
        call = node.func if isinstance(node, ast.Call) else node
        if isinstance(call, ast.Attribute) and ast.unparse(call.value) == "qdenv":
            public = getattr(qdenv, call.attr)
            if isinstance(node, ast.Call):
                named = {one.arg: None for one in node.keywords if one.arg}
                inspect.signature(public).bind(*node.args, **named)
    if not long and "class " not in code:  # the package of `test_plugin`
        exec(compile(tree, "page", "exec"), {})


def test_the_readme_lists_every_command_in_its_own_words():
    table = (ROOT / "README.md").read_text().partition("<!-- commands -->")[2]
    lines = table.partition("<!-- end of commands -->")[0].strip().splitlines()[2:]
    summaries = {
        name: " ".join(inspect.getdoc(pkgutil.resolve_name(place)).split("\n\n")[0].split())
        for name, place in COMMANDS.items()
    }
    assert lines == [f"| `qdenv {name}` | {text} |" for name, text in summaries.items()]


def test_the_readme_is_short():
    assert len((ROOT / "README.md").read_text().split()) <= 1500


def test_public_names_are_documented_with_parameters_shapes_and_errors():
    pytest.importorskip("sphinx", reason="the book needs the extra docs")
    conf = runpy.run_path(str(ROOT / "notebooks" / "conf.py"))
    public = {name: getattr(qdenv, name) for name in qdenv.__all__}
    for home, names in conf["RECORDS"].items():
        public |= {name: pkgutil.resolve_name(f"qdenv.{home}:{name}") for name in names}
    array = re.compile(r"\b(Array|ndarray)\b")
    shape = re.compile(r"\[|\b(bool|int32|float32)[,(]")
    functions, shared, missing = [], {}, []
    for name, member in public.items():
        if inspect.isfunction(member):
            functions.append(inspect.unwrap(member))
        if not isinstance(member, type):
            continue
        comments = conf["comments_of"](member)
        if name.endswith("Options"):  # the fields of such a dictionary are also its base's
            comments = shared = shared | comments
        for field, kind in inspect.get_annotations(member).items():
            said = comments.get(field, member.__doc__ if field in member.__doc__ else "")
            is_array = array.search(str(kind)) and "Callable" not in str(kind)
            missing += [f"{name}.{field}"] * bool(not said or (is_array and not shape.search(said)))
        for key, one in vars(member).items():
            one = getattr(one, "fget", None) or getattr(one, "__func__", one)
            if key[0] != "_" and getattr(one, "__qualname__", "") == f"{name}.{key}":
                functions.append(one)
    for one in functions:
        said = inspect.getdoc(one)
        parameters = set(inspect.signature(one).parameters) - {"self", "cls"}
        missing += [f"{one}: {name}" for name in parameters if not re.search(rf"\b{name}\b", said)]
        unshaped = array.search(str(one.__annotations__)) and not shape.search(said)
        silent = "raise InputError" in inspect.getsource(one) and "InputError" not in said
        missing += [str(one)] * bool(unshaped or silent)
    assert not missing and len(functions) > 100


@pytest.fixture(scope="module")
def book(tmp_path_factory):
    """Build the book; give its folder."""
    pytest.importorskip("myst_nb", reason="the book needs the extra docs")
    path = tmp_path_factory.mktemp("book")
    command = [sys.executable, "-m", "sphinx", "-W", "-q", str(ROOT / "notebooks"), str(path)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return path


@pytest.mark.slow
def test_the_book_builds_without_warnings_and_has_all_names(book):
    python = (book / "reference" / "python.html").read_text()
    assert [name for name in qdenv.__all__ if name not in python] == []
    commands = (book / "reference" / "commands.html").read_text()
    assert [name for name in COMMANDS if f"usage: qdenv {name} " not in commands] == []


@pytest.mark.slow
def test_live_pages_of_the_book_share_what_draws_them(book, opened):
    live = re.findall('(?:href|src)="(live/.*?)"', (book / "live.html").read_text())
    assert len(set(live)) == 10 and all((book / page).exists() for page in live)
    assert sum(path.stat().st_size for path in (book / "live").iterdir()) < 3_000_000
    with opened(book / "live" / "warehouse-even-archive.html") as page:
        page.wait_for_selector("body[data-ready] #map .main-svg")
