"""Pages: the data in them and the text that a reader sees, of reports, explorers and replays."""

import base64
import gzip
import html
import json
import re
from pathlib import Path
from typing import Any

import cli_cases
from record import sha

PART = (12, 13)  # an explorer that grows nothing
FLOATS = True  # searches and generators of the zoo
CASES = cli_cases.PAGES
# Dates, versions and the machine, as pages state them.
INSTALLATION = {
    r"\b\d+ [A-Z][a-z]+ 20\d\d\b": "DATE",
    r"(?m)^\d+\.\d+\.\d+\S*$": "VERSION",
    r"(?m)^machine\n.*": "machine\nMACHINE",
}


def run(case: str) -> Any:
    """Run the commands of a case; `digest` reduces the pages that they write."""
    import cli

    return cli.run(case)


def digest(path: Path, folder: Path) -> dict[str, Any]:
    """Return the facts and the packed arrays of a page, and its visible text."""
    import cli

    page = path.read_text("utf-8")
    assert page.startswith("<!DOCTYPE html>")
    facts: Any = None
    packed = {}
    scripts = re.findall(
        r'<script type="application/(\w+)" id="([\w-]+)">(.*?)</script>', page, re.S
    )
    for kind, name, text in scripts:
        if kind == "json":
            facts = cli.clean(json.loads(text), folder)
        elif "plotly" not in name:  # a library
            packed[name] = sha(gzip.decompress(base64.b64decode(text)))
    drawn = len(re.findall(r"<svg|<img", page))
    page = re.sub(r"<(script|style|svg)\b.*?</\1>", " ", page, flags=re.S)
    page = re.sub(r"</?(?:tr|p|h\d|li|div|section|table|title|option)\b[^>]*>", "\n", page)
    text = html.unescape(re.sub(r"<[^>]*>", " ", page))
    lines = (" ".join(line.split()) for line in text.split("\n"))
    text = cli.normal("\n".join(line for line in lines if line), folder)
    for pattern, placeholder in INSTALLATION.items():
        text = re.sub(pattern, placeholder, text)
    return {"facts": facts, "packed": packed, "pictures": drawn, "text": text}
