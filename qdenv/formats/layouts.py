"""Layout files: JSON with a list of equally long rows under "layout".

The same shape as the layouts published with the paper, so those read as they are; other keys
are ignored on reading. Headers that contradict the rows lose: the rows are what is simulated.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np

from qdenv.files import write_json
from qdenv.grid import draw, parse
from qdenv.types import Array, InputError

MAX_BYTES = 32 * 2**20
MAX_SIDE = 1000  # rows or columns; nothing larger was tried


def read_layout(path: str | Path, tiles: str) -> np.ndarray:
    """Read a layout.

    Args:
        path: a JSON file with a list of strings under "layout".
        tiles: the domain's alphabet.

    Returns:
        int8 [H, W].

    Raises:
        InputError: the file is missing, too big, no JSON, or holds no proper layout.
    """
    try:
        if Path(path).stat().st_size > MAX_BYTES:
            raise InputError(f"{path}: bigger than {MAX_BYTES >> 20} MB, this is no layout file")
        content = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
        raise InputError(f"{path}: not a JSON file ({error})") from error
    rows = content.get("layout") if isinstance(content, dict) else None
    if not isinstance(rows, list) or not all(isinstance(row, str) for row in rows):
        raise InputError(f'{path}: expected an object with a list of strings under "layout"')
    if max(len(rows), *(len(row) for row in rows), 0) > MAX_SIDE:
        raise InputError(f"{path}: more than {MAX_SIDE} rows or columns are not supported")
    try:
        return parse(rows, tiles)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def write_layout(path: str | Path, layout: Array, tiles: str, **details: Any) -> None:
    """Write a layout (int8 [H, W]) with any JSON-ready `details` beside it, atomically."""
    rows = draw(layout, tiles)
    head = {"n_row": len(rows), "n_col": len(rows[0])}
    write_json(Path(path), {**head, **details, "layout": rows})
