"""Golden corpus: record what qdenv produces today, and compare with it later.

    python tests/golden/record.py [SECTION ...] [--part K/N] [--check | --texts]

A section is a module in this folder with `CASES` (the names of its cases in order, a dict by name,
or a function that gives either), `run(name)` (a JSON-ready value) and `PART = (K, N)`: the test
suite checks the cases K, K + N, K + 2 N, ... Without a flag, the cases are recorded in
data/SECTION.json, one a line. A string that starts with "sha256:" counts as a number; in other
strings, the numbers are compared as numbers and the rest as text.

What XLA makes of floats depends on its version and on the processor. A section with `FLOATS = True`
holds such numbers: where automata that amplify the last bit draw other than on the machine that
recorded (data/machine.json), it is skipped, and says so.
"""

import argparse
import functools
import hashlib
import importlib
import json
import os
import re
import sys
import time
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
if __name__ == "__main__":
    # The test suite switches XLA's optimizations off, which changes the last bits of its floats.
    os.environ["JAX_DISABLE_MOST_OPTIMIZATIONS"] = "0"
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Compiling takes most of the time of the sections that use XLA.
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(Path.home() / ".cache" / "qdenv-golden"))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.1")

_NUMBER = re.compile(r"(?:(?<![\w.])-)?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?")


def sha(data: Any) -> str:
    """Return the hash of bytes, of a text, or of an array with its shape and type."""
    if isinstance(data, str):
        data = data.encode()
    if not isinstance(data, bytes):
        data = f"{data.dtype}{data.shape}".encode() + data.tobytes()
    return "sha256:" + hashlib.sha256(data).hexdigest()[:16]


def sections() -> list[str]:
    """Return the names of all sections, without importing them."""
    defines = re.compile(r"^(def )?CASES\b", re.M)
    return sorted(p.stem for p in HERE.glob("*.py") if defines.search(p.read_text("utf-8")))


def load(section: str) -> tuple[Any, list[str]]:
    """Import a section; return its module and the names of its cases."""
    if str(HERE) not in sys.path:
        sys.path.insert(0, str(HERE))
    module = importlib.import_module(section)
    return module, list(module.CASES() if callable(module.CASES) else module.CASES)


def differences(old: Any, new: Any, path: str = "") -> list[tuple[bool, str]]:
    """Return where two JSON values differ, and whether a number does."""
    if isinstance(old, dict) and isinstance(new, dict):
        keys = sorted({*old, *new})
        missing = [
            (True, f"{path}/{key}: only in one") for key in keys if (key in old) ^ (key in new)
        ]
        both = [key for key in keys if key in old and key in new]
        return missing + [
            d for key in both for d in differences(old[key], new[key], f"{path}/{key}")
        ]
    if isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        pairs = enumerate(zip(old, new, strict=True))
        return [d for i, (a, b) in pairs for d in differences(a, b, f"{path}/{i}")]
    if json.dumps(old) == json.dumps(new):  # as text: 1 is not 1.0, NaN is NaN
        return []
    number = True
    if isinstance(old, str) and isinstance(new, str) and not (old + new).count("sha256:"):
        numbers = [[float(n) for n in _NUMBER.findall(text)] for text in (old, new)]
        number = numbers[0] != numbers[1]
    return [(number, f"{path}: {json.dumps(old)[:200]} -> {json.dumps(new)[:200]}")]


def read(section: str) -> dict[str, Any]:
    """Return the recorded values of a section by case."""
    path = HERE / "data" / f"{section}.json"
    return json.loads(path.read_text("utf-8")) if path.exists() else {}


def write(section: str, values: dict[str, Any]) -> None:
    """Write the values of a section, one case a line."""
    dump = {"sort_keys": True, "separators": (",", ":")}
    lines = [f"{json.dumps(name)}:{json.dumps(values[name], **dump)}" for name in sorted(values)]
    (HERE / "data").mkdir(exist_ok=True)
    (HERE / "data" / f"{section}.json").write_text("{\n" + ",\n".join(lines) + "\n}\n", "utf-8")


@functools.cache
def floats_are_comparable() -> bool:
    """Return True if XLA's floats on this machine are those of the machine that recorded."""
    import adapter

    return read("machine") == {"floats": sha(adapter.float_fingerprint())}


def run(section: str, part: tuple[int, int], mode: str) -> bool:
    """Run every part[1]-th case of a section and record or compare; return if numbers are equal."""
    module, names = load(section)
    if mode and getattr(module, "FLOATS", False) and not floats_are_comparable():
        print(f"{section}: skipped, XLA's floats are not those of the machine that recorded")
        return True
    start = time.process_time()
    chosen = names[part[0] :: part[1]]
    values = {name: json.loads(json.dumps(module.run(name))) for name in chosen}
    recorded = read(section)
    found = [d for name in chosen for d in differences(recorded.get(name), values[name], name)]
    if mode:
        absent = sorted({*recorded} ^ {*names})
        found += [(True, f"{name}: case only in one of code and data") for name in absent]
    numbers, texts = ([text for n, text in found if n is kind] for kind in (True, False))
    if mode == "" or (mode == "texts" and not numbers):
        keep = {name: recorded[name] for name in names if name in recorded}
        write(section, keep | values)
    equal = sum(recorded.get(name) == values[name] for name in chosen)
    print(
        f"{section}: {len(chosen)} cases, {equal} equal, {len(numbers)} numbers differ, "
        f"{len(texts)} texts differ, {time.process_time() - start:.1f} CPU s",
        flush=True,
    )
    for kind, lines in (("number", numbers), ("text", texts)) if mode else ():
        print(*(f"  {kind} {line}" for line in lines[:40]), sep="\n", end="\n" if lines else "")
    return not numbers or mode == ""


def main() -> int:
    """Record or compare the sections given, or all."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("sections", nargs="*", metavar="SECTION", help=", ".join(sections()))
    parser.add_argument("--part", default="0/1", help="K/N: every N-th case from the K-th on")
    parser.add_argument("--own-part", action="store_true", help="the part that the section states")
    mode = parser.add_mutually_exclusive_group()
    mode.add_argument("--check", action="store_true", help="compare, change nothing")
    mode.add_argument("--texts", action="store_true", help="record unless a number differs")
    given = parser.parse_args()
    k, n = map(int, given.part.split("/"))
    results = []
    for section in given.sections or sections():
        part = load(section)[0].PART if given.own_part else (k % n, n)
        results.append(
            run(section, part, "check" if given.check else "texts" if given.texts else "")
        )
    return 0 if all(results) else 1


if __name__ == "__main__":
    sys.exit(main())
