"""The maze agent once more in plain numpy, one step at a time, from the written rules."""

from collections import deque
from pathlib import Path

import numpy as np
from scipy.special import expit

DATA = Path(__file__).parent / "data" / "maze"
STEP = {0: (0, 1), 1: (1, 0), 2: (0, -1), 3: (-1, 0)}  # (row, column) of right, down, left, up
CODE = {"empty": (1, 0, 0), "wall": (2, 5, 0), "goal": (8, 1, 0)}


def recorded_network() -> dict[str, np.ndarray]:
    """Read the recorded network: its weights under PyTorch's names."""
    stored = np.load(DATA / "policy_random16_fixture.npz")
    return {name[2:]: stored[name] for name in stored if name.startswith("w.")}


def bfs(layout: np.ndarray, start: int) -> dict[int, int]:
    """Count the moves from one tile to every tile it reaches."""
    rows, cols = layout.shape
    seen, queue = {start: 0}, deque([start])
    while queue:
        here = queue.popleft()
        for dr, dc in STEP.values():
            r, c = here // cols + dr, here % cols + dc
            if 0 <= r < rows and 0 <= c < cols and not layout[r, c] and r * cols + c not in seen:
                seen[r * cols + c] = seen[here] + 1
                queue.append(r * cols + c)
    return seen


def longest(layout: np.ndarray) -> tuple[int, int, int]:
    """Find (length, start, goal): the farthest pair, smallest start, then smallest goal."""
    free = np.flatnonzero(layout.reshape(-1) == 0)
    pairs = [(far, -a, -b) for a in free for b, far in bfs(layout, int(a)).items()]
    far, start, goal = max(pairs, default=(0, 0, 0))
    return far, -start, -goal


def look(layout: np.ndarray, goal: int, position: int, heading: int) -> np.ndarray:
    """Draw the 5x5 view [x, y, channel]."""
    rows, cols = layout.shape
    picture = np.zeros((5, 5, 3))
    dr, dc = STEP[heading]
    sr, sc = STEP[(heading + 1) % 4]
    for x in range(5):
        for y in range(5):
            ahead, right = 4 - y, x - 2
            r = position // cols + ahead * dr + right * sr
            c = position % cols + ahead * dc + right * sc
            inside = 0 <= r < rows and 0 <= c < cols
            kind = "wall" if not inside or layout[r, c] else "empty"
            picture[x, y] = CODE["goal" if inside and r * cols + c == goal else kind]
    return picture


def network(w: dict, picture: np.ndarray, compass: np.ndarray, h: np.ndarray, c: np.ndarray):
    """Step the published network in float64 -> logits, h, c; weights under PyTorch's names."""
    signal = (picture / 10).transpose(2, 0, 1)
    conv = np.zeros((16, 3, 3))
    for i in range(3):
        for j in range(3):
            patch = signal[:, i : i + 3, j : j + 3]
            conv[:, i, j] = (w["image_conv.0.weight"] * patch).sum((1, 2, 3))
    conv = np.maximum(conv + w["image_conv.0.bias"][:, None, None], 0).reshape(-1)
    facing = w["scalar_embed.weight"] @ compass + w["scalar_embed.bias"]
    gates = w["rnn.rnn.weight_ih_l0"] @ np.concatenate([conv, facing]) + w["rnn.rnn.bias_ih_l0"]
    gates = gates + w["rnn.rnn.weight_hh_l0"] @ h + w["rnn.rnn.bias_hh_l0"]
    i, f, g, o = np.split(gates, 4)
    c = expit(f) * c + expit(i) * np.tanh(g)
    h = expit(o) * np.tanh(c)
    inner = np.tanh(w["actor.0.0.weight"] @ h + w["actor.0.0.bias"])
    return w["actor.1.linear.weight"] @ inner + w["actor.1.linear.bias"], h, c


def choose(logits: np.ndarray, draw: float) -> int:
    """Invert the distribution function of the softmax."""
    share = np.exp(logits - logits.max())
    ladder = np.cumsum(share / share.sum())
    return int(min((draw >= ladder).sum(), len(logits) - 1))


def move(layout: np.ndarray, goal: int, position: int, heading: int, action: int):
    """Act once -> position, heading, success."""
    rows, cols = layout.shape
    heading = (heading + {0: 3, 1: 1}.get(action, 0)) % 4
    if action != 2:
        return position, heading, False
    r, c = position // cols + STEP[heading][0], position % cols + STEP[heading][1]
    if r * cols + c == goal and 0 <= r < rows and 0 <= c < cols:
        return position, heading, True
    blocked = not (0 <= r < rows and 0 <= c < cols) or layout[r, c]
    return (position if blocked else r * cols + c), heading, False


def episode(w: dict, layout: np.ndarray, heading: int, draws: np.ndarray):
    """Run the agent from the longest path's start -> success, length, poses."""
    _, position, goal = longest(layout)
    units = w["rnn.rnn.weight_hh_l0"].shape[1]
    h, c = np.zeros(units), np.zeros(units)
    poses = [(position, heading)]
    for t, draw in enumerate(draws):
        compass = np.eye(4)[heading]
        logits, h, c = network(w, look(layout, goal, position, heading), compass, h, c)
        position, heading, success = move(layout, goal, position, heading, choose(logits, draw))
        poses.append((position, heading))
        if success:
            return True, t + 1, poses
    return False, len(draws), poses
