"""The report: one page about floor plans or the best plan of a run, to send or print."""
