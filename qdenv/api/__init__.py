"""The functions of a notebook: `qdenv.train`, `qdenv.simulate`, `qdenv.repair`, ..."""
