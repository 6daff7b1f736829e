"""The scores: what the search sees of a layout and its runs."""
