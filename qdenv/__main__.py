"""`python -m qdenv`: the command line, where its script is not on the path."""

from qdenv.cli import main

main()
