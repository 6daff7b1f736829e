"""Three halls as people draw them: columns, rooms, doors, an L-shape, a large one."""

import numpy as np


def columns_and_rooms() -> list[str]:
    """30 x 40: columns, two doors, a closed room; stations at the left and inside."""
    hall = _walled(30, 40)
    _racks(hall, (4, 26), (7, 38))
    hall[:9, 30:] = "#"  # a closed room in the corner
    hall[9:26:8, 12:36:8] = "#"  # columns
    hall[0, 20] = hall[29, 20] = "."  # two doors
    hall[3:27:3, 1] = "w"
    hall[2, 8:29:5] = "w"
    return _served(hall)


def ell() -> list[str]:
    """36 x 44, an L: the upper right part is outside; stations at the left and at the bottom."""
    hall = _walled(36, 44)
    _racks(hall, (3, 33), (5, 42))
    hall[:16, 26:] = "#"
    hall[3:32:3, 1] = "w"
    hall[34, 8:40:6] = "w"
    return _served(hall)


def large() -> list[str]:
    """60 x 80: 1,100 shelves, 60 stations on one side, where people draw blocks of shelves."""
    hall = np.full((60, 80), ".")
    _racks(hall, (2, 58), (4, 78))
    hall[:, 0] = "w"
    rows = _served(hall)
    spare = sum(row.count("@") for row in rows) - 1100
    for row, column in np.argwhere(hall == "@")[::-1][:spare]:  # from the corner on
        hall[row, column] = "."
    return _served(hall)


def _walled(rows: int, cols: int) -> np.ndarray:
    """Draw an empty hall inside walls."""
    hall = np.full((rows, cols), "#")
    hall[1:-1, 1:-1] = "."
    return hall


def _racks(hall: np.ndarray, rows: tuple[int, int], cols: tuple[int, int]) -> None:
    """Fill a rectangle with double racks of 2 x 10 with aisles between them."""
    for row in range(rows[0], rows[1] - 1, 4):
        for column in range(cols[0], cols[1] - 9, 12):
            hall[row : row + 2, column : column + 10] = "@"


def _served(hall: np.ndarray) -> list[str]:
    """Put an endpoint above and below each shelf that has room there, and drop the others."""
    hall[hall == "e"] = "."
    shelf = hall == "@"
    beside = np.zeros_like(shelf)
    beside[:-1] |= shelf[1:]
    beside[1:] |= shelf[:-1]
    hall[beside & (hall == ".")] = "e"
    grid = np.pad(hall, 1, constant_values="#")
    around = [grid[:-2, 1:-1], grid[2:, 1:-1], grid[1:-1, :-2], grid[1:-1, 2:]]
    hall[shelf & ~np.any([one == "e" for one in around], axis=0)] = "."
    return ["".join(row) for row in hall]
