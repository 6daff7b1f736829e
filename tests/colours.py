"""Colours as eyes see them that lack one kind of cone, for tests of what pictures tell apart."""

import itertools
from collections.abc import Iterable

import numpy as np
from matplotlib.colors import to_rgb

# In linear light (Machado, Oliveira and Fernandes 2009, severity 1).
CONES = {
    "all": np.eye(3),
    "no red": [(0.152286, 1.052583, -0.204868), (0.114503, 0.786281, 0.099216),
               (-0.003882, -0.048116, 1.051998)],
    "no green": [(0.367322, 0.860646, -0.227968), (0.280085, 0.672501, 0.047413),
                 (-0.011820, 0.042940, 0.968881)],
    "no blue": [(1.255528, -0.076749, -0.178779), (-0.078411, 0.930809, 0.147602),
                (0.004733, 0.691367, 0.303900)],
}  # fmt: skip
XYZ = np.array([(0.4124, 0.3576, 0.1805), (0.2126, 0.7152, 0.0722), (0.0193, 0.1192, 0.9505)])


def lab(colour, cones: str) -> np.ndarray:
    """Turn a colour as these cones see it into CIE L*a*b* (white is that of sRGB)."""
    share = np.array(to_rgb(colour))
    light = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    seen = np.clip(np.array(CONES[cones]) @ light, 0, 1)
    x, y, z = np.cbrt(XYZ @ seen / (XYZ @ np.ones(3)))
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


def nearest(colours: Iterable[str], cones: str) -> float:
    """Measure the least distance of two colours; 2.3 is just noticeable."""
    seen = [lab(colour, cones) for colour in colours]
    pairs = itertools.combinations(seen, 2)
    return min(float(np.linalg.norm(one - other)) for one, other in pairs)
