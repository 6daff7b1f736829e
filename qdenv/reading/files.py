"""Bytes and text of files, of a limited size."""

import codecs
from pathlib import Path

from qdenv.types import DamagedError, InputError

MEGABYTE = 2**20
LARGEST = 64 * MEGABYTE  # of a file of text
UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def damaged(source: Path | str, reason: object) -> DamagedError:
    """Make the error for a file that holds something else than it should."""
    return DamagedError(f"{source}: cannot be read ({reason})")


def unreadable(path: Path | str, error: OSError) -> InputError:
    """Make the error for a file that the system does not give out."""
    return InputError(f"{path}: cannot be read ({error.strerror or error})")


def read_bytes(path: Path | str, most: int = LARGEST) -> bytes:
    """Read a whole file, or what a pipe gives.

    Args:
        path: the file.
        most: bytes; no more are ever read.

    Raises:
        InputError: it cannot be read, or is bigger.
    """
    try:
        with open(path, "rb") as file:
            content = file.read(most + 1)
    except OSError as error:
        raise unreadable(path, error) from error
    except ValueError as error:  # a name that no file can have
        raise InputError(f"{path}: cannot be read ({error})") from error
    if len(content) > most:
        raise damaged(path, f"bigger than {most // MEGABYTE} MB")
    return content


def read_text(path: Path | str, most: int = LARGEST, what: str = "text") -> str:
    """Read a text file as UTF-8, or as the UTF-16 of Windows' shell.

    Args:
        path: the file, or a pipe.
        most: bytes of it.
        what: the file should hold, for the message.

    Raises:
        InputError: it cannot be read, is bigger, or is no text.
    """
    content = read_bytes(path, most)
    try:
        return content.decode("utf-16" if content.startswith(UTF_16) else "utf-8-sig")
    except UnicodeDecodeError as error:
        raise damaged(path, f"not a {what} file: {error}") from error
