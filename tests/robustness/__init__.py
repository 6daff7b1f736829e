"""A campaign of attacks with random seeds: `python tests/robustness --minutes 10`."""
