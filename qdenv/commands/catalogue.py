"""All commands: where each is, and what it is in one line, without importing it."""

import ast
from collections.abc import Callable
from importlib import util
from pathlib import Path

# Name -> ``module:function``, in the order of help: plans, studies, searches, mazes.
COMMANDS = {
    "render": "qdenv.commands.drawings:render",
    "check": "qdenv.commands.layouts:check",
    "simulate": "qdenv.commands.simulate:simulate",
    "replay": "qdenv.commands.replay:replay",
    "repair": "qdenv.commands.layouts:repair",
    "compare": "qdenv.commands.traffic:compare",
    "sweep": "qdenv.commands.traffic:sweep",
    "scalability": "qdenv.commands.traffic:scalability",
    "report": "qdenv.commands.report:report",
    "layout human": "qdenv.commands.sizes:layout_human",
    "layout tile": "qdenv.commands.sizes:layout_tile",
    "layout symbols": "qdenv.commands.drawings:layout_symbols",
    "zoo": "qdenv.commands.zoo:zoo",
    "presets": "qdenv.commands.presets:presets",
    "train": "qdenv.commands.train:train",
    "resume": "qdenv.commands.runs:resume",
    "plot": "qdenv.commands.plot:plot",
    "generate": "qdenv.commands.runs:generate",
    "series": "qdenv.commands.sizes:series",
    "explore": "qdenv.commands.explore:explore",
    "export": "qdenv.commands.export:export",
    "surrogate": "qdenv.commands.surrogate:surrogate",
    "train-agent": "qdenv.commands.mazes:train_agent",
    "evaluate-agent": "qdenv.commands.episodes:evaluate_agent",
    "convert-agent": "qdenv.commands.mazes:convert_agent",
    "completion": "qdenv.commands.completion:completion",
}


def summary_of(command: str) -> Callable[[], None]:
    """Make a function that stands in for a command in help: the same docstring, no options.

    The docstring is read from the source: importing a command would take its seconds.
    """
    module, _, name = COMMANDS[command].partition(":")
    spec = util.find_spec(module)
    assert spec is not None and spec.origin is not None
    (node,) = (
        node
        for node in ast.parse(Path(spec.origin).read_text()).body
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and node.name == name
    )

    def summary() -> None:
        return None

    summary.__doc__ = (ast.get_docstring(node) or "").partition("\n")[0]
    return summary
