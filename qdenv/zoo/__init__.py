"""Trained generators that ship: for each domain a small run whose elites have names.

qdenv/zoo/DOMAIN/config.json, manifest.json, metrics.csv   of the run they come from
qdenv/zoo/DOMAIN/archive.npz       the chosen elites alone
qdenv/zoo/DOMAIN/generators.json   their names and figures

`experiments/zoo.py` writes them; every command that takes a run takes ``zoo:DOMAIN/NAME``, too.
"""
