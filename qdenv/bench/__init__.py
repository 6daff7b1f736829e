"""Benchmarks: `python -m qdenv.bench NAME --json FILE`."""
