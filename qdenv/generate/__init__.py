"""The generators: a neural cellular automaton that draws tiles, or the tiles themselves."""
