"""The repair: a layout close to the given one that obeys every rule."""
