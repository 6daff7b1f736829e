"""The generator: a neural cellular automaton that draws tiles."""
