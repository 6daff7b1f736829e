"""The repair: the closest layout that obeys every rule."""
