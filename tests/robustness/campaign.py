"""Attack for some minutes and count: every attempt has a seed that repeats it."""

import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from qdenv.io.files import write_json
from qdenv.types import InputError
from robustness.attack import Attack, Attempt
from robustness.catalogue import ATTACKS


@dataclass
class Tally:
    """What all attempts of one attack came to."""

    attack: Attack  # which one
    attempts: int = 0  # how many were made
    count: int = 0  # how much they tried, in the attack's unit
    seconds: float = 0.0  # time they took
    # (number of the attempt, what it broke)
    faults: list[tuple[int, str]] = field(default_factory=list)
    notes: Counter = field(default_factory=Counter)  # other counts

    def add(self, number: int, attempt: Attempt, seconds: float) -> None:
        """Count one attempt."""
        self.attempts += 1
        self.count += attempt.count
        self.seconds += seconds
        self.faults += [(number, fault) for fault in attempt.faults]
        self.notes.update(attempt.notes)

    def facts(self) -> dict[str, Any]:
        """Give the row of the table, JSON-ready."""
        return {
            "attack": self.attack.name,
            "promise": self.attack.promise,
            "attempts": self.attempts,
            self.attack.unit: self.count,
            "seconds": round(self.seconds, 1),
            "notes": dict(self.notes),
            "faults": [{"attempt": number, "fault": fault} for number, fault in self.faults],
        }

    def __str__(self) -> str:
        """Say the row in one line."""
        notes = "".join(f", {count:,} {name}" for name, count in sorted(self.notes.items()))
        faults = f"{len(self.faults)} faults" if self.faults else "no fault"
        return (
            f"{self.attack.name:14} {self.count:>12,} {self.attack.unit:12} {faults:>10} "
            f"in {self.seconds:5.0f} s{notes}"
        )


def run(
    minutes: float = 10.0,
    seed: Annotated[int | None, tyro.conf.arg(metavar="NUMBER")] = None,
    only: tuple[str, ...] = (),
    first: int = 0,
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
) -> dict[str, Any]:
    """Attack with fresh seeds, each attack for an equal share of the time, and print the counts.

    Ends with exit code 1 if a promise was broken; the line of the fault says how to repeat it.
    Interrupted, it prints and writes what it has counted.

    Args:
        minutes: how long all attacks last together; each makes one attempt at least.
        seed: of the whole campaign; a fresh one unless given.
        only: the names of some attacks.
        first: number of the first attempt of each.
        json_file: where to write the counts.

    Raises:
        InputError: there is no such attack.
    """
    chosen = choose(only)
    seed = int(np.random.SeedSequence().generate_state(1)[0]) if seed is None else seed
    print(f"seed {seed}: {', '.join(attack.name for attack in chosen)}", flush=True)
    tallies = [Tally(attack) for attack in chosen]
    end = time.monotonic() + 60 * minutes
    try:
        while not all(tally.attempts for tally in tallies) or time.monotonic() < end:
            tally = min(tallies, key=lambda one: (one.attempts > 0, one.seconds))
            attack_once(tally, seed, first + tally.attempts)
    finally:  # what was counted before an interrupt counts
        result = {"seed": seed, "attacks": [tally.facts() for tally in tallies]}
        print(*tallies, sep="\n", flush=True)
        if json_file:
            write_json(json_file, result)
    if any(tally.faults for tally in tallies):
        sys.exit(1)
    return result


def choose(names: Sequence[str]) -> list[Attack]:
    """Find attacks by their names, all where there are none."""
    known = {attack.name: attack for attack in ATTACKS}
    for name in names:
        if name not in known:
            raise InputError(f"there is no attack {name!r}: choose from {', '.join(known)}")
    return [known[name] for name in names] or list(ATTACKS)


def attack_once(tally: Tally, seed: int, number: int) -> None:
    """Make one attempt and say at once what it broke."""
    name = tally.attack.name
    chance = np.random.default_rng([seed, number, *name.encode()])
    begun = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="qdenv-robustness-") as folder:
        attempt = tally.attack.attempt(chance, Path(folder))
    tally.add(number, attempt, time.monotonic() - begun)
    for fault in attempt.faults:
        again = f"--only {name} --seed {seed} --first {number} --minutes 0"
        print(f"FAULT {fault}\n  again: python tests/robustness {again}", flush=True)
