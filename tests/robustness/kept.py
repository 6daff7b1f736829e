"""What a finished run left in its folder, and what of it differs from an uninterrupted one."""

import csv
import io
import re
from collections.abc import Mapping
from pathlib import Path

CHECKPOINT = re.compile(r"checkpoints/[0-9]{6}\.npz")
NEWEST = "the newest checkpoint"
PICTURE = ".png"
MANIFEST = "manifest.json"  # says when the run began
TIMED = ("metrics.csv",)


def contents(run: Path) -> dict[str, bytes]:
    """Read what must be the same however often a run was interrupted, by name.

    Seconds are left out, and so is the number of checkpoints, which the clock decides; of pictures
    and of the manifest only the names count.
    """
    found: dict[str, bytes] = {}
    for path in sorted(run.rglob("*")):
        name = path.relative_to(run).as_posix()
        if not path.is_file() or name == ".lock":
            continue
        if CHECKPOINT.fullmatch(name):
            found[NEWEST] = path.name.encode() + path.read_bytes()
        elif name == MANIFEST or path.suffix == PICTURE:
            found[name] = b""
        elif name in TIMED:
            found[name] = _without_seconds(path.read_text())
        else:
            found[name] = path.read_bytes()
    return found


def _without_seconds(table: str) -> bytes:
    rows = list(csv.DictReader(io.StringIO(table)))
    return repr([{**row, "seconds": ""} for row in rows]).encode()


def differences(wanted: Mapping[str, bytes], found: Mapping[str, bytes]) -> list[str]:
    """List what is missing, left behind or other than it should be."""
    missing = [f"{name} is missing" for name in wanted if name not in found]
    left = [f"{name} was left behind" for name in found if name not in wanted]
    other = [f"{name} differs" for name in wanted if found.get(name, b"") != wanted[name]]
    return missing + left + [line for line in other if line[:-8] in found]
