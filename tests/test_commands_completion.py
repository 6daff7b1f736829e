"""Completion in a shell knows what the commands know, and nothing else."""

import shutil
import subprocess

import pytest

from qdenv.cli.main import run
from qdenv.shipped import names

# What a shell does when somebody presses the tab key after these words.
ASK = """
source script.bash
while IFS= read -r line; do
  IFS=' ' read -ra COMP_WORDS <<< "$line"
  [[ "$line" == *' ' ]] && COMP_WORDS+=('')
  COMP_CWORD=$(( ${#COMP_WORDS[@]} - 1 ))
  _tyro_qdenv qdenv "${COMP_WORDS[COMP_CWORD]}" "${COMP_WORDS[COMP_CWORD-1]}"
  echo "${COMPREPLY[*]}"
done
"""

WANTED = {
    "qdenv si": ["simulate"],
    "qdenv lay": ["layout"],
    "qdenv layout hu": ["human"],
    "qdenv layout human --ro": ["--rows"],
    "qdenv train man": [
        "manufacturing",
        "manufacturing-quick",
        "manufacturing-map-elites",
        "manufacturing-cma-es",
        "manufacturing-dsage",
    ],
    "qdenv train quick --emi": ["--emitters"],
    "qdenv train --config": [],  # no such option
    "qdenv train --domain war": ["warehouse-even", "warehouse-uneven"],
    "qdenv simulate --effort ": ["low", "high"],
    "qdenv repair plan.txt --polish f": ["full"],
    "qdenv zoo warehouse-even/be": ["warehouse-even/best"],
    # Bash parts words at colons, and puts back what stands before the last one.
    "qdenv generate zoo : warehouse-even/be": ["warehouse-even/best"],
    "qdenv generate zoo : warehouse-even/best --fra": ["--frames"],
    "qdenv plot zo": [f"zoo:{home}/{name}" for home, known in names().items() for name in known],
}


@pytest.fixture(scope="module")
def script(tmp_path_factory):
    if not shutil.which("bash"):
        pytest.skip("no bash on this machine")
    return tmp_path_factory.mktemp("completion")


@pytest.mark.slow
def test_the_tab_key_knows_commands_options_presets_and_names(script, capsys):
    assert run(["completion", "bash"]) == 0
    (script / "script.bash").write_text(capsys.readouterr().out)
    done = subprocess.run(
        ["bash", "-c", ASK],
        input="\n".join([*WANTED, "qdenv train quick --"]) + "\n",
        cwd=script,
        capture_output=True,
        text=True,
        check=True,
    )
    answers = [sorted(answer.split()) for answer in done.stdout.splitlines()]
    assert all(word.startswith("--") for word in answers.pop())  # no part of a description
    assert answers == [sorted(wanted) for wanted in WANTED.values()], done.stderr


@pytest.mark.slow
def test_zsh_is_told_the_same(capsys):
    assert run(["completion", "zsh"]) == 0
    said = capsys.readouterr().out
    assert said.startswith("#compdef qdenv") and "'manufacturing-quick'" in said
    assert run(["completion", "fish"]) == 2
