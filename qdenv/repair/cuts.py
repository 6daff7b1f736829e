"""Cuts that forbid the disconnections of one solution of the program."""

from typing import NamedTuple

import numpy as np
from scipy import ndimage

CROSS = ndimage.generate_binary_structure(2, 1)


class Cut(NamedTuple):
    """If both ends drive, one of the gates does: drives(ends) - sum drives(gates) <= ends - 1."""

    ends: list[int]  # positions; one where the main part always drives
    gates: list[int]


def separate(drives: np.ndarray, always: np.ndarray, most: int = 4) -> list[Cut]:
    """Find cuts for every part of the driving area that is cut off from the main one.

    Args:
        drives: bool [H, W], the driving area of a solution.
        always: bool [H, W], cells that drive in every layout.
        most: cells of each part to cut for.

    Returns:
        Cuts through minimal separators; empty when the area is one piece.
    """
    labels, parts = ndimage.label(drives, CROSS)
    if parts <= 1:
        return []
    sizes = np.bincount(labels.ravel())[1:]
    anchored = np.unique(labels[always & drives])
    main = int(anchored[0]) if anchored.size else 1 + int(np.argmax(sizes))
    anchor = np.argwhere(labels == main)[0]
    cuts = []
    for part in range(1, parts + 1):
        if part == main:
            continue
        inside = labels == part
        shell = ndimage.binary_dilation(inside, CROSS) & ~inside
        beyond, _ = ndimage.label(~shell & ~inside, CROSS)
        outside = beyond == beyond[tuple(anchor)]
        gates = shell & ndimage.binary_dilation(outside, CROSS)
        cells = np.flatnonzero(inside)
        other = [] if anchored.size else [int(np.ravel_multi_index(anchor, drives.shape))]
        for cell in cells[np.linspace(0, cells.size - 1, min(most, cells.size)).astype(int)]:
            cuts.append(Cut([int(cell), *other], np.flatnonzero(gates).tolist()))
    return cuts
