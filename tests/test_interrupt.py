"""Ctrl-C and SIGTERM: one line, exit code 130, at any moment, whatever is under way."""

import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from conftest import SMALL
from robustness.sandbox import start

from qdenv.run.directory import RunDirectory

pytestmark = pytest.mark.slow

# A program that writes a file and then works for ever in compiled code, as a simulation does.
BUSY = """
import sys
from qdenv.interrupt import advise, watch
watch()
sys.argv = ["qdenv", "simulate", "a plan.txt"]
advise("runs/a")
advise("runs/a/part")
import numba
from pathlib import Path
from qdenv.io.files import write_atomically

@numba.njit(nogil=True)
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


def ready(script: str, folder: Path, *words: str, **options: str) -> subprocess.Popen:
    """Start a program, and wait until it says that it is ready."""
    work = start(["-c", script, *words], folder, "0", **options)
    assert work.stdout.readline() == "ready\n"
    return work


@pytest.mark.parametrize(
    ("number", "signals"), [(signal.SIGINT, 1), (signal.SIGINT, 3), (signal.SIGTERM, 1)]
)
def test_it_ends_compiled_code_and_leaves_no_half_written_file(tmp_path, number, signals):
    work = ready(BUSY, tmp_path)
    assert len(list(tmp_path.iterdir())) == 1  # what is being written, under another name
    for _ in range(signals):
        if work.poll() is None:
            work.send_signal(number)
    _, said = work.communicate(timeout=60)  # the loop would take hours
    assert work.returncode == 130
    assert said == "\nqdenv: stopped; `qdenv resume runs/a` goes on\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("moment", ["numpy", "jax", "numba", "a run/config.json"])
def test_a_command_ends_at_any_moment_and_says_how_to_begin_anew(tmp_path, moment):
    """When it has imported something, or begins to compile for a search of many seconds."""
    words = "-X importtime -m qdenv train quick --out"
    command = [sys.executable, *words.split(), "a run"]
    log, imported = tmp_path / "log", re.compile(rf"\| +{moment}$", re.MULTILINE)
    with log.open("w") as said:
        work = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=said)
    while not (imported.search(log.read_text()) or (tmp_path / moment).exists()):
        assert work.poll() is None
        time.sleep(0.01)
    work.send_signal(signal.SIGINT)
    assert work.wait(timeout=60) == 130
    last = re.findall("^qdenv: .*", log.read_text(), re.MULTILINE)[-1]
    over = "qdenv: stopped; `qdenv train quick --out 'a run'` runs it again"
    assert last in (over, "qdenv: stopped; `qdenv resume 'a run'` goes on")
    assert "Traceback" not in log.read_text()


# A program that has done something and works on, and whose saving takes so many seconds.
UNSAVED = """
import time
from pathlib import Path
from qdenv.interrupt import advise, save_first, watch

watch()
advise("runs/a")

def save():
    time.sleep({seconds})
    Path("saved").touch()

save_first(save)
print("ready", flush=True)
time.sleep(600)
"""


@pytest.mark.parametrize(("seconds", "signals", "saved"), [(0.2, 1, True), (600, 2, False)])
def test_what_is_done_is_saved_first_unless_asked_once_more(tmp_path, seconds, signals, saved):
    work = ready(UNSAVED.format(seconds=seconds), tmp_path)
    work.send_signal(signal.SIGTERM)
    said = work.stderr.readline() + work.stderr.readline()
    assert said == "\nqdenv: saving; interrupt again to quit at once\n"
    if signals > 1:
        work.send_signal(signal.SIGTERM)
    _, said = work.communicate(timeout=60)
    assert work.returncode == 130
    assert (tmp_path / "saved").exists() is saved
    assert said.splitlines()[-1] == "qdenv: stopped; `qdenv resume runs/a` goes on"


def test_a_file_whose_name_is_no_text_does_not_prevent_the_end(tmp_path):
    script = UNSAVED.replace("advise(", "str(").format(seconds=0)
    work = ready(script, tmp_path, "\udcff.json", errors="surrogateescape")
    work.send_signal(signal.SIGINT)
    _, said = work.communicate(timeout=60)
    assert work.returncode == 130
    assert said.splitlines()[-1] == "qdenv: stopped; `qdenv '\udcff.json'` runs it again"


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
    work = start(["-c", RUN, *command], tmp_path, "0")
    metrics = tmp_path / "run" / "metrics.csv"
    while not metrics.exists() or metrics.read_text().count("\n") < 3:
        assert work.poll() is None
        time.sleep(0.05)
    work.send_signal(signal.SIGTERM)
    work.communicate(timeout=120)
    (checkpoint,) = (tmp_path / "run" / "checkpoints").iterdir()
    assert work.returncode == 130 and int(checkpoint.stem) >= 2
    assert len(RunDirectory.open(tmp_path / "run").archive) > 0
