"""The campaign: attempts to break promises with random seeds, each of which can be repeated."""

import functools
import importlib
import shlex
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from qdenv import InputError, interrupt
from qdenv.io.files import write_json


class Attempt(NamedTuple):
    """The outcome of one attempt."""

    trials: int  # in the attack's unit
    faults: Sequence[str] = ()  # a line for each promise that was broken
    notes: Mapping[str, int] = {}  # other counts by name, summed over attempts


class Attack(NamedTuple):
    """A kind of attempt to break a promise."""

    name: str
    promise: str
    unit: str  # of its trials, in plural
    # (random generator, an empty folder) -> outcome. Everything random comes from the generator,
    # so the seed of an attempt repeats it.
    attempt: Callable[..., Attempt]
    kinds: Sequence[str] = ()  # that `attempt` can be held to, by its argument `kind`


# Module -> names of its attacks.
MODULES = {
    "inputs": ("FILES", "COMMANDS"),
    "edges": ("EDGES",),
    "interruptions": ("OPERATIONS", "SIGNALS"),
    "repairs": ("REPAIRS",),
    "halls": ("HALLS",),
    "fleets": ("AUDITS",),
}


def all_attacks() -> list[Attack]:
    """Return the attacks of all modules."""
    modules = {name: importlib.import_module(f"robustness.{name}") for name in MODULES}
    return [getattr(modules[module], name) for module in MODULES for name in MODULES[module]]


def run(
    minutes: float = 10.0,
    seed: int | None = None,
    only: tuple[str, ...] = (),
    first: int = 0,
    json: Path | None = None,
) -> dict[str, Any]:
    """Attack with random seeds, each attack for an equal share of the time, and print the counts.

    Ends with exit code 1 if a promise was broken; the line of the fault says how to repeat it. An
    interrupted campaign prints and writes its counts so far.

    Args:
        minutes: duration of all attacks together; each makes at least one attempt.
        seed: of the whole campaign; a new one unless given.
        only: the names of some attacks; a kind of its attempts may follow: "edges:side by side".
        first: number of the first attempt of each.
        json: file of the counts.
    """
    attacks = {attack.name: attack for attack in all_attacks()}
    for name in only:
        base, _, kind = name.partition(":")
        if base not in attacks:
            raise InputError(f"there is no attack {base!r}: choose from {', '.join(attacks)}")
        attack = attacks[base]
        if kind and kind not in attack.kinds:
            raise InputError(f"{base} has no kind {kind!r}: {', '.join(attack.kinds) or 'none'}")
        held = functools.partial(attack.attempt, kind=kind)
        attacks[name] = attack._replace(name=name, attempt=held) if kind else attack
    seed = int(np.random.SeedSequence().generate_state(1)[0]) if seed is None else seed
    rows = [new_row(attacks[name]) for name in only or attacks]
    print(f"seed {seed}: {', '.join(row['attack'] for row in rows)}", flush=True)
    result = {"seed": seed, "attacks": rows}

    def report() -> None:
        for row in rows:
            unit = attacks[row["attack"]].unit
            notes = "".join(f", {count:,} {name}" for name, count in sorted(row["notes"].items()))
            outcome = f"{len(row['faults']) or 'no'} faults in {row['seconds']:.0f} s"
            print(f"{row['attack']:11} {row[unit]:>9,} {unit:12} {outcome}{notes}", flush=True)
        if json:
            write_json(json, result)

    interrupt.save_first(report)
    end = time.monotonic() + 60 * minutes
    while not all(row["attempts"] for row in rows) or time.monotonic() < end:
        row = min(rows, key=lambda row: (row["attempts"] > 0, row["seconds"]))
        attack_once(attacks[row["attack"]], row, seed, first + row["attempts"])
    interrupt.save_first(None)
    report()
    if any(row["faults"] for row in rows):
        sys.exit(1)
    return result


def new_row(attack: Attack) -> dict[str, Any]:
    """Return the counts of an attack that was not attempted yet."""
    counts = {"attempts": 0, attack.unit: 0, "seconds": 0.0, "notes": Counter(), "faults": []}
    return {"attack": attack.name, "promise": attack.promise, **counts}


def attack_once(attack: Attack, row: dict[str, Any], seed: int, number: int) -> None:
    """Make one attempt, add it to the counts and print its faults."""
    rng = np.random.default_rng([seed, number, *attack.name.encode()])
    begin = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="qdenv-robustness-") as folder:
        attempt = attack.attempt(rng, Path(folder))
    row["attempts"] += 1
    row[attack.unit] += attempt.trials
    row["seconds"] += time.monotonic() - begin
    row["notes"].update(attempt.notes)
    for fault in attempt.faults:
        row["faults"].append({"attempt": number, "fault": fault})
        again = f"--only {shlex.quote(attack.name)} --seed {seed} --first {number} --minutes 0"
        print(f"FAULT {fault}\n  again: python tests/robustness {again}", flush=True)
