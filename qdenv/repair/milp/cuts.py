"""Cuts that forbid the disconnections of one solution of the program.

Connectivity as lazy inequalities over minimal separators (Carvajal et al. 2013,
https://doi.org/10.1287/opre.2013.1183; Fischetti et al. 2017,
https://doi.org/10.1007/s12532-016-0111-0): stated up front there would be exponentially many, and
few of them matter.
"""

from typing import NamedTuple

import numpy as np
from scipy import ndimage

CROSS = ndimage.generate_binary_structure(2, 1)


class Cut(NamedTuple):
    """If both ends drive, so does a gate: driving(ends) - sum driving(gates) <= ends - 1."""

    ends: list[int]  # positions; one where the main part always drives, else one in either part
    gates: list[int]  # positions of a separator: every path between the ends crosses one of them


def separate(driving: np.ndarray, always: np.ndarray, most: int = 4) -> list[Cut]:
    """Find cuts for every part of the driving area that is cut off from the main one.

    Args:
        driving: bool [H, W], the driving area of a solution.
        always: bool [H, W], cells that drive in every layout.
        most: cells of each part to cut for.

    Returns:
        Cuts through minimal separators; empty when the area is one piece.
    """
    labels, parts = ndimage.label(driving, CROSS)
    if parts <= 1:
        return []
    sizes = np.bincount(labels.ravel())[1:]
    anchored = np.unique(labels[always & driving])
    main = int(anchored[0]) if anchored.size else 1 + int(np.argmax(sizes))
    anchor = np.argwhere(labels == main)[0]
    # Where the main part always drives, its end needs no variable and the cut is tighter.
    other = [] if anchored.size else [int(np.ravel_multi_index(tuple(anchor), driving.shape))]
    cuts = []
    for part in range(1, parts + 1):
        if part == main:
            continue
        inside = labels == part
        gates = np.flatnonzero(_separator(inside, anchor)).tolist()
        cells = np.flatnonzero(inside)
        for cell in cells[np.linspace(0, cells.size - 1, min(most, cells.size)).astype(int)]:
            cuts.append(Cut([int(cell), *other], gates))
    return cuts


def _separator(inside: np.ndarray, anchor: np.ndarray) -> np.ndarray:
    """Mark the cells around a part that face the anchor's side (bool [H, W]).

    Of the shell only these: what lies in pockets behind it separates nothing.
    """
    shell = ndimage.binary_dilation(inside, CROSS) & ~inside
    beyond, _ = ndimage.label(~shell & ~inside, CROSS)
    outside = beyond == beyond[tuple(anchor)]
    return shell & ndimage.binary_dilation(outside, CROSS)
