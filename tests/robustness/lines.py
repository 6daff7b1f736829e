"""Command lines that are harmless, and extreme values for their options."""

from collections.abc import Mapping

SHORT = ("--agents", "2", "--timesteps", "5")
ONCE = (*SHORT, "--seeds", "1")
# A search of seconds, whose folder is what commands are told to read.
SEARCH = (
    *("train", "maze-quick", "--evaluations", "8", "--simulations", "1", "--timesteps", "20"),
    *("--rows", "6", "--cols", "6", "--steps", "3", "--hidden", "4", "--emitters", "1"),
    *("--batch", "4", "--archive", "0", "36", "4", "0", "36", "4", "--out", "run"),
)
# Two updates of an agent, which `resume` would go on with.
TRAINED = (
    *("train-agent", "--out", "run", "--steps", "64", "--units", "4", "--bank", "8"),
    *(
        "--fresh",
        "4",
        "--exam",
        "1",
        "--ppo.lanes",
        "4",
        "--ppo.timesteps",
        "8",
        "--ppo.minibatches",
        "1",
    ),
)
# Command lines that do next to nothing; the word in capitals is a file or folder.
LINES: Mapping[str, tuple[str, ...]] = {
    "check": ("check", "PLAN"),
    "render": ("render", "PLAN"),
    "simulate": ("simulate", "PLAN", *ONCE, "--no-verdict"),
    "replay": ("replay", "PLAN", *SHORT),
    "repair": ("repair", "PLAN"),
    "compare": ("compare", "PLAN", *ONCE),
    "sweep": ("sweep", "PLAN", *ONCE),
    "scalability": ("scalability", "PLAN", *ONCE),
    "report": ("report", "MAZE", "--timesteps", "5"),
    "layout human": ("layout", "human"),
    "layout tile": ("layout", "tile", "PLAN", "--rows", "12", "--cols", "22"),
    "layout symbols": ("layout", "symbols"),
    "zoo": ("zoo",),
    "presets": ("presets",),
    "plot": ("plot", "RUN", "--out", "pictures"),
    "generate": ("generate", "RUN"),
    "export": ("export", "RUN"),
    "explore": ("explore", "RUN", "--growth", "0"),
    "series": ("series", "RUN", "--sizes", "6x6"),
    "surrogate": ("surrogate", "RUN"),
    "evaluate-agent": ("evaluate-agent", "MAZE", "--runs", "1"),
    "convert-agent": ("convert-agent", "MAZE"),
    "completion": ("completion", "bash"),
    # Refused at the very end of all checks: there is a run already, or nothing is left to do.
    "train": ("train", "maze-quick", "--out", "RUN"),
    "train-agent": ("train-agent", "--out", "AGENT"),
}
EXTREMES = (
    *("-1", "0", "1", "0.5", "-0.0", "nan", "inf", "-inf", "1e308", "1e-320", "9" * 30, "9" * 5000),
    *("2147483648", "9223372036854775808", "18446744073709551616", "-2147483649", "", " ", "a"),
    *("\x1b[31m", "two\nlines", "\u00e9\u202e", "1:99999999999", "5:1", "1,1,1", "1,", "best"),
    "a.png",
    *("a.json", "a.csv", "a.html", ".", "..", "/", "/dev/null", "-", "--", "=", "plan.json", "run"),
    *("nowhere/x.json", "None", "True", "auto", "zoo:moon", "zoo:maze-walls", "pbs", "pibt", "low"),
)


# These end at a folder that holds a run already; in another one they would train for hours.
TRAINING, PLACES = ("train", "train-agent"), ("--out", "--run-dir")
