"""The campaign: attacks with fresh seeds on files, runs, fleets and repairs, and their counts."""

from robustness.campaign import run as run
