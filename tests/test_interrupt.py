"""Ctrl-C: one line, exit code 130, within two seconds, at any moment of any command."""

import os
import signal
import subprocess
import sys
import time

import pytest

# A program that writes a file and then works for ever in compiled code, as a simulation does.
BUSY = """
import sys
from qdenv.interrupt import advise, watch
watch()
sys.argv = ["qdenv", "simulate", "a plan.txt"]
if {advice!r}:
    advise({advice!r})
import numba
from pathlib import Path
from qdenv.files import write_atomically

@numba.njit(nogil={nogil})
def spin(n):
    total = 0
    for i in range(n):
        total += i % 7 ^ total
    return total

spin(1)
def content(file):
    file.write(b"half")
    file.flush()
    print("ready", flush=True)
    spin(10**13)
write_atomically(Path("out.json"), content)
"""


@pytest.mark.parametrize("signals", [1, 3])
def test_it_ends_compiled_code_and_leaves_no_half_written_file(tmp_path, signals):
    script = BUSY.format(advice="`qdenv resume runs/a` goes on", nogil=True)
    work = subprocess.Popen(
        [sys.executable, "-c", script], stdout=-1, stderr=-1, text=True, cwd=tmp_path
    )
    assert work.stdout.readline() == "ready\n"
    assert len(list(tmp_path.iterdir())) == 1  # what is being written, under another name
    begin = time.perf_counter()
    for _ in range(signals):
        if work.poll() is None:
            work.send_signal(signal.SIGINT)
    _, said = work.communicate(timeout=20)
    assert (work.returncode, time.perf_counter() - begin < 2) == (130, True)
    assert said == "\nqdenv: stopped; `qdenv resume runs/a` goes on\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("seconds", [1.0, 1.8, 2.6, 4.0])
def test_a_command_ends_at_any_moment_and_says_how_to_begin_anew(tmp_path, seconds):
    command = [sys.executable, "-m", "qdenv", "train", "quick", "--out", "a run"]
    work = subprocess.Popen(
        command, cwd=tmp_path, stdout=-1, stderr=-1, text=True, env=dict(os.environ)
    )
    time.sleep(seconds)  # imports, then compiling
    work.send_signal(signal.SIGINT)
    begin = time.perf_counter()
    _, said = work.communicate(timeout=20)
    assert (work.returncode, time.perf_counter() - begin < 2) == (130, True), said
    last = said.splitlines()[-1]
    anew = "qdenv: stopped; `qdenv train quick --out 'a run'` begins anew"
    assert last in (anew, "qdenv: stopped; `qdenv resume 'a run'` goes on")
    assert "Traceback" not in said
