"""Evolution strategies behind one face."""
