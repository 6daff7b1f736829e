"""Functions compiled by numba for one core of the host, free of the interpreter lock."""

import numba


def compiled(function):
    """Compile with a disk cache where there is a writable place for one.

    The cache watches only the file of the outermost function: after editing a function that is
    called from another file, touch that file.
    """
    try:
        return numba.njit(cache=True, nogil=True)(function)
    except RuntimeError:  # numba finds no writable cache folder
        return numba.njit(nogil=True)(function)
