"""Pictures, films and HTML pages, from saved results only."""
