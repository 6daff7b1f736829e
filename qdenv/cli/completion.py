"""The command completion: a script that lets a shell complete commands, options and names."""

import contextlib
import io
import pkgutil
from typing import Any, Literal

import tyro

from qdenv.cli.main import COMMANDS
from qdenv.cli.parser import MARKERS, SPEC, command, completion_spec
from qdenv.cli.rules import Choices, make_rules
from qdenv.configurations import PRESETS
from qdenv.ops.output import say
from qdenv.shipped import PREFIX, names

# Two corrections of tyro's script. Which words a colon does not part: ours as well (zoo:NAME).
_WORDS = 'set(spec.get("subcommands", {}).keys())'
# Bash puts back what stands before the last colon of a word: it is left out of the completions.
_UP_TO_COLON = ('#"$prefix"}', "#*:}")
_RUNS = ("plot", "generate", "series", "export", "explore", "report")  # take zoo:DOMAIN/NAME


def completion(shell: tyro.conf.Positional[Literal["bash", "zsh"]]) -> None:
    """Print the script with which a shell completes commands, options and names.

    Args:
        shell: which shell.

    Examples:
        ``qdenv completion bash``
    """
    text = io.StringIO()
    with contextlib.redirect_stdout(text), contextlib.suppress(SystemExit):
        tyro.extras.subcommand_cli_from_dict(
            {name: command(pkgutil.resolve_name(one)) for name, one in COMMANDS.items()},
            prog="qdenv",
            args=["--tyro-print-completion", shell],
            config=MARKERS,
            registry=make_rules(Choices(), []),
        )
    script = text.getvalue()
    spec = _with_names(completion_spec(script))
    lines = [f"{SPEC}{spec!r}" if line.startswith(SPEC) else line for line in script.splitlines()]
    script = "\n".join(lines).replace(_WORDS, f'{_WORDS} | set(spec.get("words", []))')
    say(script.replace(*_UP_TO_COLON))


def _with_names(spec: dict[str, Any]) -> dict[str, Any]:
    """Add two-word commands, presets and names of the zoo to tyro's description of the program."""
    commands: dict[str, Any] = {}
    for name, one in spec["subcommands"].items():
        for option in one["options"]:
            # A line break would end the description, and offer what follows as a word.
            option["description"] = " ".join(option["description"].split())
            # Complete an option's names where its help begins with them, like {low,high}.
            begin, brace, _ = option["description"].partition("}")
            if brace and begin[:1] == "{" and "," in begin and option["type"] != "choice":
                option |= {"type": "choice", "choices": begin[1:].split(",")}
        first, _, second = name.partition(" ")
        if second:
            empty = {"description": first, "options": [], "subcommands": {}, "frontier_groups": []}
            commands.setdefault(first, empty)["subcommands"][second] = one
        else:
            commands[name] = one
    shipped = [f"{domain}/{name}" for domain, known in names().items() for name in known]
    words = [f"{PREFIX}{name}" for name in shipped]
    listed = {"train": list(PRESETS), "zoo": [*names(), *shipped], **dict.fromkeys(_RUNS, words)}
    for name, known in listed.items():
        # The same options follow each name that the command takes.
        follow = {**commands[name], "description": "name"}
        commands[name]["subcommands"] = dict.fromkeys(known, follow)
    return spec | {"subcommands": commands, "words": words}
