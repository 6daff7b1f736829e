"""The life of one search: its configuration, its loop, its run directory."""
