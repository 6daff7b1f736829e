"""The command completion: a script that lets a shell complete commands, options and names."""

import ast
import re
import subprocess
import sys
from collections.abc import Sequence
from typing import Any, Literal

import tyro

from qdenv.presets import PRESETS
from qdenv.zoo import PREFIX, names

SPEC = re.compile(r"^(COMPLETION_SPEC = )(\{.*\})$", re.MULTILINE)
WORDS = 'set(spec.get("subcommands", {}).keys())'  # which words a colon does not part
# What stands before a colon, which bash puts back, is left out whatever words stood before it.
UP_TO_COLON = ('#"$prefix"}', "#*:}")
RUNS = ("plot", "generate", "series", "export")  # commands that take generators of the zoo
CHOICES = re.compile(r"^(?:\{None\}\|)?\{([^}]*,[^}]*)\}")


def completion(shell: tyro.conf.Positional[Literal["bash", "zsh"]]) -> None:
    """Print what lets a shell complete commands, options and names.

    Args:
        shell: which shell.
    """
    # Asked of another process: this one is in the middle of reading its own command line.
    command = [sys.executable, "-m", "qdenv", "--tyro-print-completion", shell]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    said = said.replace(WORDS, f'{WORDS} | set(spec.get("words", []))').replace(*UP_TO_COLON)
    print(SPEC.sub(lambda match: match[1] + repr(_as_spoken(match[2])), said), end="")


def _as_spoken(spec: str) -> dict[str, Any]:
    """Let the parser's description of the program know two-word commands, presets and names."""
    root: dict[str, Any] = ast.literal_eval(spec)
    commands: dict[str, Any] = {}
    for name, command in root["subcommands"].items():
        for option in command["options"]:
            _know_choices(option)
        first, _, second = name.partition(" ")
        if second:
            group = commands.setdefault(first, _group(first))
            group["subcommands"][second] = command
        else:
            commands[name] = command
    train = commands["train"]
    train["subcommands"] = {name: {**train, "description": "preset"} for name in PRESETS}
    shipped = [f"{domain}/{name}" for domain, known in names().items() for name in known]
    _know_names(commands["zoo"], [*names(), *shipped])
    words = [f"{PREFIX}{name}" for name in shipped]
    for name in RUNS:
        _know_names(commands[name], words)
    return root | {"subcommands": commands, "words": words}


def _know_names(command: dict[str, Any], known: Sequence[str]) -> None:
    """Complete names where a command takes one; whatever it is, the same options follow."""
    command["subcommands"] = {name: {**command, "description": "zoo"} for name in known}


def _group(name: str) -> dict[str, Any]:
    return {"description": name, "options": [], "subcommands": {}, "frontier_groups": []}


def _know_choices(option: dict[str, Any]) -> None:
    """Complete an option's names where its help lists them."""
    listed = CHOICES.match(option["description"])
    if listed and option["type"] != "choice":
        option |= {"type": "choice", "choices": listed[1].split(",")}
