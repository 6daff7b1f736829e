"""The command line `qdenv`."""
