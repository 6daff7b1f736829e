"""Files are written whole or not at all, and what is no file stays what it is."""

import os
import threading

import pytest

from qdenv.files import write_atomically, write_json
from qdenv.interrupt import unfinished
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
    reader.join(10)
    assert heard == [b"text"] and pipe.is_fifo()


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
