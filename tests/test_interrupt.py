"""Ctrl-C and SIGTERM: one line, exit code 130, within two seconds, at any moment."""

import os
import signal
import subprocess
import sys
import time

import pytest
from conftest import SMALL

from qdenv.run.directory import RunDirectory

pytestmark = pytest.mark.slow

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
from qdenv.io.files import write_atomically

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


@pytest.mark.parametrize(
    ("number", "signals"), [(signal.SIGINT, 1), (signal.SIGINT, 3), (signal.SIGTERM, 1)]
)
def test_it_ends_compiled_code_and_leaves_no_half_written_file(tmp_path, number, signals):
    script = BUSY.format(advice="`qdenv resume runs/a` goes on", nogil=True)
    work = subprocess.Popen(
        [sys.executable, "-c", script], stdout=-1, stderr=-1, text=True, cwd=tmp_path
    )
    assert work.stdout.readline() == "ready\n"
    assert len(list(tmp_path.iterdir())) == 1  # what is being written, under another name
    begin = time.perf_counter()
    for _ in range(signals):
        if work.poll() is None:
            work.send_signal(number)
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


# A program that has done something and works on, and whose saving takes so many seconds.
UNSAVED = """
import time
from pathlib import Path
from qdenv.interrupt import advise, save_first, watch

watch()
advise("`qdenv resume runs/a` goes on")

def save():
    time.sleep({seconds})
    Path("saved").touch()

save_first(save)
print("ready", flush=True)
time.sleep(60)
"""


@pytest.mark.parametrize(("seconds", "signals", "saved"), [(0.2, 1, True), (30, 2, False)])
def test_what_is_done_is_saved_first_unless_asked_once_more(tmp_path, seconds, signals, saved):
    script = UNSAVED.format(seconds=seconds)
    work = subprocess.Popen(
        [sys.executable, "-c", script], stdout=-1, stderr=-1, text=True, cwd=tmp_path
    )
    assert work.stdout.readline() == "ready\n"
    for _ in range(signals):
        work.send_signal(signal.SIGTERM)
        time.sleep(0.5 if signals > 1 else 0)
    _, said = work.communicate(timeout=10)
    assert work.returncode == 130
    assert (tmp_path / "saved").exists() is saved
    assert "saving what is done; once more ends at once" in said
    assert said.splitlines()[-1] == "qdenv: stopped; `qdenv resume runs/a` goes on"


RUN = """
import sys
from qdenv import interrupt
from qdenv.cli import main as cli
from qdenv.run.loop import Publisher

interrupt.watch()
Publisher.has_time = False
sys.exit(cli.run(sys.argv[1:]))
"""


def test_a_search_that_is_terminated_keeps_its_last_iteration(tmp_path):
    options = SMALL.replace("--evaluations 6", "--evaluations 6000").split()
    command = ["train", "quick", "--out", "run", "--checkpoint-every", "1000", *options]
    work = subprocess.Popen(
        [sys.executable, "-c", RUN, *command], cwd=tmp_path, stdout=-1, stderr=-1, text=True
    )
    metrics = tmp_path / "run" / "metrics.csv"
    while not metrics.exists() or metrics.read_text().count("\n") < 3:
        assert work.poll() is None
        time.sleep(0.05)
    work.send_signal(signal.SIGTERM)
    work.communicate(timeout=30)
    (checkpoint,) = (tmp_path / "run" / "checkpoints").iterdir()
    assert work.returncode == 130 and int(checkpoint.stem) >= 2
    assert len(RunDirectory.open(tmp_path / "run").archive) > 0
