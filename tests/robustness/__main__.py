"""Run the campaign: `python tests/robustness --minutes 10`."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # tests import `robustness` from there, too

from experiments.program import run_program
from robustness.campaign import run

if __name__ == "__main__":
    run_program(run, "python tests/robustness")
