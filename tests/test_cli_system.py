"""What the system refuses is one line and exit code 2: permissions, full and closed outputs."""

import os
import subprocess
import sys

import pytest
from robustness.sandbox import BECOME_ORDINARY, start
from small_warehouse import ROWS

from qdenv.cli import main as cli

CLOSED = "os.close({})"


def call(line, folder, prepare=BECOME_ORDINARY, **streams):
    """Run a command line in a process of its own, which something is done to before it begins."""
    process = start(["-m", "qdenv", *line.split()], folder, prepare, **streams)
    _, stderr = process.communicate()
    return subprocess.CompletedProcess(line, process.returncode, None, stderr)


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "plan.txt").write_text("\n".join(ROWS))
    (tmp_path / "locked").mkdir()
    (tmp_path / "locked" / "plan.txt").write_text("\n".join(ROWS))
    (tmp_path / "locked").chmod(0)
    yield tmp_path
    (tmp_path / "locked").chmod(0o755)


def refusal(done):
    """Return the line of a refusal; there must be nothing else."""
    lines = done.stderr.splitlines()
    assert done.returncode == 2 and len(lines) == 1 and lines[0].startswith("qdenv: "), done.stderr
    return lines[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    "line",
    [
        "check locked/plan.txt",
        "check plan.txt --json locked/facts.json",
        "render plan.txt --out locked/plan.png",
        "train quick --out locked/run",
        "train-agent --out locked/agent",
        "resume locked/run",
        "report locked/plan.txt",
        "convert-agent locked/model.tar",
    ],
)
def test_a_folder_without_permission_is_one_line(line, folder):
    said = refusal(call(line, folder))
    assert "locked" in said and "Permission denied" in said


@pytest.mark.parametrize("line", ["presets", "--help", "train --help", "--version"])
def test_a_full_standard_output_is_one_line(line, folder):
    with open("/dev/full", "w") as full:
        done = call(line, folder, stdout=full)
    assert "standard output: No space left on device" in refusal(done)


@pytest.mark.slow
@pytest.mark.parametrize("stream", [0, 1, 2])
def test_closed_streams_are_no_traceback_and_no_file(stream, folder):
    done = call("check plan.txt --json f.json", folder, CLOSED.format(stream))
    if stream == 1:
        assert "standard output is closed" in refusal(done)
    else:
        assert (done.returncode, done.stderr) == (0, "")


def test_a_folder_that_is_gone_is_one_line(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    tmp_path.rmdir()
    assert cli.run(["layout", "human", "--rows", "20", "--cols", "20"]) == 2
    said = capsys.readouterr().err
    assert "No such file or directory" in said and said.count("\n") == 1


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (MemoryError(), "more memory than there is"),
        (RuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 9 bytes."), "more memory"),
        (OSError(5, "Input/output error", "a\nb"), "a b: Input/output error"),
        (OSError(36, "File name too long", "x" * 999), "File name too long"),
        (ConnectionRefusedError(111, "Connection refused"), "the system: Connection refused"),
    ],
)
def test_errors_of_the_system_are_one_line(error, said, monkeypatch, capsys):
    def fail(*_):
        raise error

    monkeypatch.setattr(cli, "_run_general", fail)
    assert cli.run([]) == 2
    line = capsys.readouterr().err
    assert said in line and line.count("\n") == 1 and len(line) < 300


def test_a_defect_of_ours_is_not_hidden(monkeypatch):
    def fail(*_):
        raise RuntimeError("a defect")

    monkeypatch.setattr(cli, "_run_general", fail)
    with pytest.raises(RuntimeError, match="a defect"):
        cli.run([])


def test_a_name_that_is_no_text_is_refused(folder, capsys):
    assert cli.run(["check", "\udcff.json"]) == 2
    assert capsys.readouterr().err == "qdenv: \\udcff.json: not UTF-8: give the file another name\n"


# Run the program, then say where jax keeps what it compiles, and how precise it is.
PROGRAM = """
import os
os._exit = lambda code: print(os.environ["JAX_COMPILATION_CACHE_DIR"])
from qdenv.cli.main import main
main()
import jax
print(jax.config.jax_enable_x64)
"""


@pytest.mark.slow
def test_empty_environment_variables_count_as_none_and_precision_is_ours(tmp_path):
    names = "XDG_CACHE_HOME", "JAX_COMPILATION_CACHE_DIR"
    changed = {**dict.fromkeys(names, ""), "HOME": str(tmp_path), "JAX_ENABLE_X64": "1"}
    command = [sys.executable, "-c", PROGRAM]
    done = subprocess.run(
        command, cwd=tmp_path, env=os.environ | changed, capture_output=True, text=True
    )
    *_, cache, wide = done.stdout.splitlines()
    assert (cache, wide) == (str(tmp_path / ".cache" / "qdenv" / "jax"), "False")
