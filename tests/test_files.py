"""Files are written whole or not at all, and what is no file stays what it is."""

import os
import threading

import pytest

from qdenv.interrupt import unfinished
from qdenv.io.files import TEMPORARY_PREFIX, sweep, write_atomically, write_json
from qdenv.types import InputError


def test_a_link_is_followed_and_stays(tmp_path):
    (tmp_path / "true.json").write_text("old")
    (tmp_path / "link.json").symlink_to("true.json")
    write_json(tmp_path / "link.json", 1)
    assert (tmp_path / "link.json").is_symlink()
    assert (tmp_path / "true.json").read_text() == "1\n"


def test_a_pipe_is_written_into_and_stays(tmp_path):
    pipe, heard = tmp_path / "pipe", []
    os.mkfifo(pipe)
    reader = threading.Thread(target=lambda: heard.append(pipe.read_bytes()))
    reader.start()
    write_atomically(pipe, lambda file: file.write(b"text"))
    reader.join(600)
    assert heard == [b"text"] and pipe.is_fifo()


@pytest.mark.parametrize("mode", [0o600, 0o664])
def test_a_file_that_is_replaced_keeps_its_permissions(tmp_path, mode):
    target = tmp_path / "a.json"
    target.touch()
    target.chmod(mode)
    write_json(target, 1)
    assert (target.stat().st_mode & 0o777, target.read_text()) == (mode, "1\n")


def test_a_file_that_may_only_be_read_is_not_replaced(tmp_path):
    target = tmp_path / "a.json"
    target.write_text("old")
    target.chmod(0o444)
    with pytest.raises(InputError, match="the file is read-only"):
        write_json(target, 1)
    assert target.read_text() == "old" and list(tmp_path.iterdir()) == [target]


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_whatever_goes_wrong_the_old_file_stays_and_nothing_else(tmp_path, error):
    target = tmp_path / "a.bin"
    target.write_bytes(b"old")

    def fail(file):
        file.write(b"half")
        raise error

    with pytest.raises((InputError, KeyboardInterrupt)):
        write_atomically(target, fail)
    assert [path.name for path in tmp_path.iterdir()] == ["a.bin"]
    assert target.read_bytes() == b"old" and not unfinished


def test_sweeping_deletes_our_temporary_files_and_no_hidden_file_of_the_user(tmp_path):
    theirs = [
        ".env.template",
        ".env.defaults",
        ".bashrc.original",
        ".vimrc.personal",
        ".a.b_c_d_e_",
    ]
    for name in theirs:
        (tmp_path / name).write_text("theirs")
    seen = []
    write_atomically(tmp_path / "a.json", lambda file: seen.extend(tmp_path.glob(".qdenv*")))
    assert [path.name.startswith(f"{TEMPORARY_PREFIX}a.json.") for path in seen] == [True]
    seen[0].write_text("left by a process that was killed")
    sweep(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"a.json", *theirs}
