"""A part of the golden corpus (tests/golden): no number has changed since it was recorded."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from golden import record

pytestmark = pytest.mark.slow

SCRIPT = Path(record.__file__)


def test_no_number_differs() -> None:
    # A process of its own: XLA must optimize as it did when the corpus was recorded.
    command = [sys.executable, str(SCRIPT), "--check", "--own-part"]
    environment = {**os.environ, "PYTHONPATH": str(SCRIPT.parents[2])}
    result = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert result.returncode == 0, result.stdout + result.stderr[-2000:]
    checked, skipped = (result.stdout.count(x) for x in (", 0 numbers differ", ": skipped, "))
    assert checked + skipped == len(record.sections()) and checked >= 5
