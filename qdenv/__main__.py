"""The program: `qdenv`, or `python -m qdenv`."""

from qdenv.interrupt import watch


def main() -> None:
    """Run the command line; Ctrl-C is answered before anything else is imported."""
    watch()
    from qdenv.cli.main import main as run

    run()


if __name__ == "__main__":
    main()
