"""The shape of the package: who may import whom, no cycles, no long functions, no pickle."""

import ast
import functools
import re
import tokenize
from collections import Counter
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path
from typing import NamedTuple

import pytest

PACKAGE = Path(__file__).parents[1] / "qdenv"
FILES = sorted(PACKAGE.rglob("*.py"))

BASE = {"types", "ranges", "grid", "guidance", "io", "lazy", "interrupt", "stats", "progress"}
STAGES = {"generators", "nca", "racks", "repairs", "simulation", "score"}
PLUGS = {"registry", "devices"}
COMMON = BASE | STAGES | PLUGS
ALLOWED = {
    "lazy": set(),
    "types": {"lazy"},
    "ranges": {"types"},
    "native": set(),
    "stats": {"types"},
    "grid": {"types", "lazy"},
    "guidance": {"types", "lazy", "grid", "highways"},
    "highways": {"grid", "native"},
    "interrupt": set(),
    "io": {"types", "ranges", "interrupt", "registry", "grid", "guidance", "lazy"},
    "devices": {"types", "lazy"},
    "progress": set(),
    "registry": {"types"},
    "nca": {"types", "generators", "grid", "guidance"},
    "racks": {"types", "generators", "grid", "simulation"},
    "generators": {"nca", "racks", "types", "ranges", "grid", "guidance", "lazy", "registry"},
    "repairs": {"types", "ranges", "grid", "lazy", "native", "devices", "progress"},
    "simulation": {"types", "ranges", "grid", "guidance", "lazy", "native", "io"} | PLUGS,
    "score": {"types", "grid", "lazy"},
    "agent": BASE | {"simulation.maze", "score", "devices"},
    "domains": COMMON,
    "settings": STAGES | {"types", "ranges", "domains.base"},
    "mesh": set(),
    "pipeline": BASE | STAGES | {"domains.base", "devices", "mesh", "settings"},
    "surrogates": {"types", "ranges"},
    "search": {"types", "ranges", "lazy", "io", "registry", "surrogates"},
    "shipped": {"types", "io"},
    "configurations": BASE | STAGES | {"domains", "search", "settings", "surrogates", "run.config"},
    "run": COMMON
    | {"search", "pipeline", "settings", "domains", "view.archive", "view.layouts"}
    | {"mesh", "shipped", "configurations"},
    "study": COMMON
    | {"agent", "domains", "pipeline", "settings", "surrogates", "run", "search", "shipped"},
    "view": COMMON | {"agent", "domains", "search.registry", "study", "run", "shipped"},
    "ops": COMMON
    | {"agent", "domains", "view", "configurations", "search", "settings"}
    | {"study", "surrogates", "run", "shipped"},
    "cli": BASE
    | PLUGS
    | {"domains", "ops", "configurations", "run", "search", "simulation", "study", "shipped"}
    | {"generators"},
    "__main__": {"cli", "interrupt"},
    "__init__": set(),  # names the public homes and imports each when it is asked for
}
# Rooms of one stage that may not look into one another: (who, whom).
APART = (
    ("simulation.mapf", "simulation.maze"),
    ("simulation.maze", "simulation.mapf"),
    ("simulation.mapf.pibt", "simulation.mapf.negotiated"),
    ("simulation.mapf.negotiated.xla", "simulation.mapf.negotiated.numba"),
    ("simulation.mapf.negotiated.numba", "simulation.mapf.negotiated.xla"),
)
FILE_LINES = 400
FUNCTION_LINES = 60  # of code: without docstring, comments and blank lines
ARGUMENTS = 8


class Import(NamedTuple):
    """One imported name, in full."""

    line: int
    name: str


@functools.cache
def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text())


@functools.cache
def nodes_of(path: Path) -> list[ast.AST]:
    return list(ast.walk(parsed(path)))


@functools.cache
def module_of(path: Path) -> str:
    """Name a file as imports name it, without the package: "grid", "repairs.audit", "repairs"."""
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" and len(parts) > 1 else parts)


def unit_of(path: Path) -> str:
    """Name the unit a file belongs to: its folder, or its own name at the top."""
    return module_of(path).split(".")[0]


def lies_in(name: str, room: str) -> bool:
    return name == room or name.startswith(f"{room}.")


@functools.cache
def imports_of(path: Path) -> list[Import]:
    """List everything a file imports, under TYPE_CHECKING and inside functions too."""
    found = []
    for node in nodes_of(path):
        if isinstance(node, ast.Import):
            found += [Import(node.lineno, alias.name) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno} imports relatively"
            found += [Import(node.lineno, f"{node.module}.{alias.name}") for alias in node.names]
    return found


def targets_of(path: Path) -> list[Import]:
    """List what a file imports of this package, without the package's name."""
    return [
        Import(line, name.removeprefix("qdenv."))
        for line, name in imports_of(path)
        if name.startswith("qdenv.")
    ]


def lazy_targets_of(path: Path) -> list[Import]:
    """List what a file has a registry import for it: text like ``qdenv.module:attribute``."""
    return [
        Import(node.lineno, node.value.removeprefix("qdenv.").replace(":", "."))
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
        if re.fullmatch(r"qdenv(\.\w+)+:\w+", node.value)
    ]


def test_a_unit_imports_what_its_row_allows():
    for path in FILES:
        own = unit_of(path)
        for line, name in imports_of(path):
            assert name.split(".")[0] not in ("experiments", "notebooks", "tests"), f"{path}:{line}"
        for line, target in targets_of(path) + lazy_targets_of(path):
            ok = any(lies_in(target, room) for room in ALLOWED[own] | {own})
            assert ok, f"{path}:{line}: {own} may not import {target}"


@pytest.mark.parametrize(("who", "whom"), APART)
def test_rooms_of_a_stage_stay_apart(who, whom):
    assert (PACKAGE / who.replace(".", "/")).is_dir(), f"{who} is gone: drop its row"
    looks = [
        f"{path}:{line}"
        for path in FILES
        for line, target in targets_of(path)
        if lies_in(module_of(path), who) and lies_in(target, whom)
    ]
    assert not looks, f"{who} looks into {whom}: {looks}"


def test_the_table_has_a_row_for_every_unit_and_no_other():
    assert set(ALLOWED) == {unit_of(path) for path in FILES}


def import_graph() -> dict[str, set[str]]:
    """Draw which file imports which; a name that is no file belongs to the file that defines it."""
    modules = {module_of(path): path for path in FILES}
    graph: dict[str, set[str]] = {}
    for module, path in modules.items():
        reached = set()
        for _, target in targets_of(path):
            while target and target not in modules:
                target = target.rpartition(".")[0]
            reached.add(target)
        graph[module] = reached - {"", module}
    return graph


def test_no_file_reaches_itself_by_its_imports():
    graph = import_graph()
    order = [*TopologicalSorter(graph).static_order()]  # a `CycleError` names files in a cycle
    assert sorted(order) == sorted(graph)


def functions_of(path: Path) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    for node in nodes_of(path):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield node


def code_lines(function: ast.FunctionDef | ast.AsyncFunctionDef, source: list[str]) -> int:
    """Count a function's lines of code, those of functions inside it too."""
    first = function.body[0]
    documented = ast.get_docstring(function) is not None
    doc = range(first.lineno, first.end_lineno + 1) if documented else range(0)
    lines = (
        source[number - 1].strip()
        for number in range(function.lineno, function.end_lineno + 1)
        if number not in doc
    )
    return sum(bool(line) and not line.startswith("#") for line in lines)


def count_arguments(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Count what a caller may give: each argument, `*rest` and `**rest` as one each, no self."""
    given = function.args
    named = [*given.posonlyargs, *given.args, *given.kwonlyargs]
    named += [rest for rest in (given.vararg, given.kwarg) if rest]
    return sum(argument.arg not in ("self", "cls") for argument in named)


def test_files_and_functions_stay_small_enough_to_read():
    for path in FILES:
        source = path.read_text().splitlines()
        assert len(source) <= FILE_LINES, f"{path}: {len(source)} lines"
        for function in functions_of(path):
            lines, arguments = code_lines(function, source), count_arguments(function)
            assert lines <= FUNCTION_LINES, f"{path}: {function.name} has {lines} lines of code"
            assert arguments <= ARGUMENTS, f"{path}: {function.name} has {arguments} arguments"


def test_lines_and_arguments_are_counted_as_said():
    text = 'def f(self, a, *b, c=1, **d):\n    """Say\n\n    more."""\n    # why\n\n    return a\n'
    function = ast.parse(text).body[0]
    assert code_lines(function, text.splitlines()) == 2
    assert count_arguments(function) == 4


def resources_of(path: Path) -> Iterator[Import]:
    """List the packages whose data a file opens; "" where it takes more than a glance to tell."""
    uses = any(name.startswith("importlib.resources") for _, name in imports_of(path))
    for node in nodes_of(path) if uses else ():
        if not isinstance(node, ast.Call) or not node.args:
            continue
        called = node.func.attr if isinstance(node.func, ast.Attribute) else node.func
        if (called.id if isinstance(called, ast.Name) else called) == "files":
            package = node.args[0]
            named = isinstance(package, ast.Constant) and isinstance(package.value, str)
            yield Import(node.lineno, package.value if named else "")


def test_a_unit_opens_no_data_of_another():
    for path in FILES:
        for line, package in resources_of(path):
            own = lies_in(package, f"qdenv.{unit_of(path)}")
            assert own, f"{path}:{line} opens data of {package or 'an unnamed package'}"


def test_no_pickle_and_no_fork():
    for path in FILES:
        for line, name in imports_of(path):
            # The converter of the published agent reads one with a restricted unpickler.
            converts = module_of(path) == "agent.convert"
            assert name.split(".")[0] != "pickle" or converts, f"{path}:{line}"
            assert name.split(".")[0] != "multiprocessing", f"{path}:{line}"
        assert "os.fork" not in path.read_text(), path


# What the package measures today. Each number may only fall: whoever needs more changes it in the
# commit that says why, whoever needs less lowers it.
MOST = {
    "lines": 32_647,
    "files": 192,
    "records": 195,
    "public names": 1_210,
    "class names used twice": 0,
    "functions of two lines": 322,
}
# Functions of the package that can be reached by plain calls from an entry point.
MOST_REACHED = {
    "pipeline:evaluate": 6,
    "repairs.recipe:repair_layout": 100,
    "run.loop:train": 43,
    "ops.traffic:simulate": 121,
    "ops.runs:generate": 186,
    "simulation.mapf.pbs.planner:_plan_window": 51,
    "simulation.mapf.negotiated.numba.rounds:_plan_window": 57,
}


def is_record(node: ast.ClassDef) -> bool:
    marks = " ".join(map(ast.unparse, [*node.bases, *node.decorator_list]))
    return any(mark in marks for mark in ("NamedTuple", "PyTreeNode", "dataclass"))


def public_names(path: Path) -> Iterator[str]:
    for node in parsed(path).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names = [node.name]
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names = [one.id for one in targets if isinstance(one, ast.Name)]
        else:
            continue
        yield from (name for name in names if not name.startswith("_"))


def test_the_package_has_not_grown():
    classes = [node for path in FILES for node in nodes_of(path) if isinstance(node, ast.ClassDef)]
    names = Counter(node.name for node in classes)
    measured = {
        "lines": sum(len(path.read_text().splitlines()) for path in FILES),
        "files": len(FILES),
        "records": sum(map(is_record, classes)),
        "public names": sum(len(list(public_names(path))) for path in FILES),
        "class names used twice": sum(count > 1 for count in names.values()),
        "functions of two lines": sum(
            code_lines(function, path.read_text().splitlines()) <= 3
            for path in FILES
            for function in functions_of(path)
        ),
    }
    assert {name: n for name, n in measured.items() if n > MOST[name]} == {}


def calls_by_function() -> dict[str, set[str]]:
    """List for each function at module level which others it names: "module:function"."""
    modules = {module_of(path): path for path in FILES}
    functions = {
        f"{module}:{node.name}": node
        for module, path in modules.items()
        for node in parsed(path).body
        if isinstance(node, ast.FunctionDef)
    }
    calls: dict[str, set[str]] = {}
    for key, function in functions.items():
        module = key.split(":")[0]
        known = {name.split(":")[1]: name for name in functions if name.startswith(f"{module}:")}
        for node in nodes_of(modules[module]):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("qdenv"):
                home = (node.module or "").removeprefix("qdenv").lstrip(".")
                for alias in node.names:
                    whole = f"{home}.{alias.name}".lstrip(".")
                    known[alias.asname or alias.name] = (
                        whole if whole in modules else f"{home}:{alias.name}"
                    )
        named = set()
        for node in ast.walk(function):
            if isinstance(node, ast.Name):
                named.add(known.get(node.id, ""))
            elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                named.add(f"{known.get(node.value.id, '')}:{node.attr}")
        calls[key] = named & functions.keys()
    return calls


def test_no_more_functions_are_reached_from_the_entry_points():
    calls = calls_by_function()
    for entry, most in MOST_REACHED.items():
        reached, waiting = set(), [entry]
        while waiting:
            function = waiting.pop()
            if function not in reached:
                reached.add(function)
                waiting += calls[function]
        assert len(reached) <= most, f"{entry}: {len(reached)} functions"


# Phrases that make a reader translate: "Return True if", "number of", "again" are the plain words.
ODD = re.compile(
    r"\b(tell whether|tells whether|whoever|nobody|somebody|anew|likewise|so many|what there is|"
    r"is told|are told|is asked|are asked|is wanted|are wanted|shall|of one's own)\b",
    re.IGNORECASE,
)


def prose_of(path: Path) -> Iterator[tuple[int, str]]:
    """List the docstrings and comments of a file, with their lines."""
    for node in nodes_of(path):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            yield node.body[0].lineno, ast.get_docstring(node) or ""
    with tokenize.open(path) as file:
        for token in tokenize.generate_tokens(file.readline):
            if token.type == tokenize.COMMENT:
                yield token.start[0], token.string


def test_docstrings_and_comments_are_plain_english():
    odd = [
        f"{path.relative_to(PACKAGE)}:{line}: {match[0]}"
        for path in FILES
        for line, text in prose_of(path)
        for match in ODD.finditer(text.replace("NOBODY", ""))  # a constant
    ]
    assert not odd
