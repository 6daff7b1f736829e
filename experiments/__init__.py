"""The paper's figures and tables, drawn from saved results.

    python -m experiments                      what there is, what is missing, what that costs
    python -m experiments figure_16            draw it from what is saved
    python -m experiments --make figure_16     make what is missing first

`pieces.py` says what a saved result is, `runs.py`, `layouts.py`, `traffic.py` and others what kinds
there are, `published.py` what the paper found.
"""

import os

# Before any script imports numpy: experiments run one simulation or search per core.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
