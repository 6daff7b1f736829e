"""The repair as an integer program: improves an annealed layout and bounds what is possible."""
