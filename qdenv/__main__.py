"""The program: `qdenv`, or `python -m qdenv`."""

import os

from qdenv.interrupt import watch


def main() -> None:
    """Run the command line; Ctrl-C is answered before anything else is imported."""
    for stream in range(3):
        try:
            os.fstat(stream)
        except OSError:  # it is closed, and must not become the number of a file
            os.open(os.devnull, os.O_RDWR)
    watch()
    from qdenv.cli.main import main as run

    run()


if __name__ == "__main__":
    main()
