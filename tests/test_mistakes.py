"""Typical mistakes: one line that says what to do, exit code 2, nothing written."""

from pathlib import Path

import pytest
from small_warehouse import ROWS as PLAN

from qdenv.cli.main import run

# Command line -> what its one line must say.
MISTAKES = {
    # Words that mean nothing.
    "simulat plan.txt": "did you mean `qdenv simulate`?",
    "layout": "`qdenv layout human`",
    "--json": "give a command before --json",
    "--agents 5 simulate plan.txt": "give a command before --agents",
    "simulate plan.txt --agent 5": "did you mean --agents?",
    "simulate plan.txt extra": "unknown argument extra",
    "simulate plan.txt --agents five": "--agents must be an integer, not 'five'",
    "simulate plan.txt --agents": "--agents needs a value",
    "repair plan.txt --shelves 1.5": "shelves '1.5': write 1100, or a range from few",
    "simulate plan.txt --seconds-per-step x": "--seconds-per-step must be a number, not 'x'",
    "train quick --archive a b c": "--archive does not have the form",
    "train quick --archive 0 9 10000 0 1 10000": "100,000,000 cells: give 1,000,000 at most",
    "simulate plan.txt --effort medium": "choose one of low, high",
    "simulate": "layout file",
    "simulate plan.txt --domain moon": "unknown domain 'moon'",
    "simulate plan.txt --agents 5 --planner dijkstra": "unknown planner 'dijkstra'",
    "simulate plan.txt --agents 5 --planner pbs --effort low": "effort low is for the negotiated",
    "train quick --planner pibt --effort high": "pibt has none: leave it out",
    "sweep plan.txt --agents 5 --planner.rule plain": "add --planner pbs",
    "train quick --planner.rule plain": "negotiated has no such setting: add --planner pbs",
    "compare plan.txt --planner pibt --planner.speed 3": "choose one of backend",
    "scalability plan.txt --planner pbs --planner.rul plain": "did you mean rule?",
    "simulate plan.txt --planner pbs --planner.rule best": "choose one of published, plain",
    "simulate plan.txt --agents 5 --planner.penalties inf": "penalties must be a finite number",
    "simulate plan.txt --planner pibt --guidance left": "unknown guidance 'left': choose one",
    "sweep plan.txt --planner pibt --guidance no.json": "no.json: cannot be read",
    "report plan.txt --planner pibt --guidance plan.txt": "plan.txt: no costs of moves",
    "sweep plan.txt --planner pibt,pbs": "unknown planner 'pibt,pbs'",
    "compare plan.txt --agents 2 --planner pibt,pibt": "name each planner once",
    "compare plan.txt --agents 2 --planner pibt,kiva": "unknown planner 'kiva'",
    "compare plan.txt --agents 2 --planner pibt,": "name each planner once",
    "compare plan.txt --agents 2 --planner pibt,pbs --planner.swap": "several planners have their",
    f"presets --json {'9' * 5000}": "File name too long",
    f"simulate {'9' * 5000}": "name too long",
    "train quick --planner pbs --planner.nodes-per-agent -3": "nodes-per-agent must be at least 0",
    "train quick --lanes 4": "unknown option --lanes: did you mean --planner.lanes?",
    "train maze-quick --planner pbs": "no fleet drives in this domain",
    "train quik": "did you mean quick?",
    "train quick --scheduler tcp://x:1": "--scheduler is for a cluster: add --executor dask",
    "train quick --executor dask --scheduler tcp://x:1 --workers 2": "leave --scheduler out",
    "train quick --executor dask --workers 0": "workers must be at least 1, not 0",
    "train quick --domain moon": "unknown domain 'moon'",
    "train quick --algorithm ga": "unknown algorithm 'ga'",
    "train quick --start zoo:manufacturing/best": "it draws .012e, this domain has .@e",
    "train quick --start zoo:warehouse-even/best@1,1": "this cell is empty",
    "train quick --start nowhere": "nowhere: no run here",
    "train quick --kernel-sizes 3 1 1 --start zoo:warehouse-even/best": "differs in kernel_sizes",
    "train warehouse-even --algorithm dsage --start zoo:warehouse-even/best": "is nca, not direct",
    "train quick --strategy newton": "--strategy newton: choose one of iso",
    "train quick --strategy LM_MA_ES": "its matrix update ignores the ranking; use lm_ma",
    "train quick --strategy=MA_ES": "its rank-mu update ignores the ranking; use full",
    "train quick --algorithm cma-es --strategy Sep_CMA_ES": "its diagonal hardly moves; use sep",
    "train quick --algorithm cma-es --strategy xNES": "element by element; use SNES or full",
    "train quick --algorithm cma-es --strategy Rm_ES": "ranks do not allow; use lm_ma",
    "train quick --algorithm cma-es --strategy GuidedES": "it needs gradients",
    "repair plan.txt --polish best": "choose one of none, quick, full",
    "layout symbols --domain moon": "unknown domain 'moon'",
    "convert plan.txt a.map --format png2": "choose one of",
    "convert plan.txt a.txt --format rhcr": "rhcr needs a name that ends in .grid",
    "convert plan.txt a.yaml": "choose by --format: rmf or ros",
    "convert plan.txt a.lif --cell 2000": "0.001 to 1000 metres",
    # Files that are not what they should be.
    "simulate nowhere.txt": "cannot be read",
    "check ragged.json": "row 1 of the layout has 3 tiles, row 0 has 11",
    "check strange.txt": "'?' at row 2, column 1",
    "simulate strange.txt": "'?' at row 2, column 1",
    "repair ragged.json": "row 1 of the layout has 3 tiles, row 0 has 11",
    "repair empty.txt": "empty.txt",
    "check no_layout.json": "list of strings",
    "check run": "no run here (manifest.json is missing)",
    "simulate empty.txt": "empty.txt",
    "simulate uneven.json --domain warehouse-even": "warehouse-uneven",
    "compare": "at least one layout file",
    "resume nowhere": "no run here",
    "simulate uneven.json --agents 9 --domain moon": "leave --domain out",
    "check plan.txt --domain manufacturing": "unknown tile 'w' at row 1, column 0",
    "check uneven.json --domain warehouse-even": "says warehouse-uneven",
    "render gone.txt": "cannot be read",
    "repair maze.txt": "have no rules: nothing to repair",
    "compare plan.txt maze.txt --agents 2": "one domain side by side",
    "compare maze.txt --agents 2": "no fleet drives",
    "scalability maze.txt --agents 2": "no fleet drives",
    "check plan.txt --domain moon": "unknown domain 'moon'",
    "plot nowhere": "no run here",
    "generate nowhere": "no run here",
    "export nowhere": "no run here",
    "explore nowhere": "no run here",
    "surrogate nowhere": "no run here",
    # Names of the zoo that nothing has, and what nobody may do to it.
    "zoo moon": "unknown domain of the zoo 'moon'",
    "zoo warehouse-even/bets": "did you mean best?",
    "zoo warehouse-even extra": "unknown argument extra",
    "generate zoo:moon/best": "unknown domain of the zoo 'moon'",
    "generate zoo:warehouse-even/bets": "did you mean best?",
    "series zoo:warehouse-even/worst": "choose one of best, regular",
    "resume zoo:warehouse-even/best": "ships with qdenv and stays as it is: `qdenv train ",
    "surrogate zoo:warehouse-even": "50",
    "explore zoo:warehouse-even/bets": "did you mean best?",
    "explore zoo:warehouse-even --growth -1": "growth must be at least 0, not -1",
    "explore zoo:warehouse-even --growth all": "--growth must be an integer, not 'all'",
    "explore zoo:warehouse-even --out map.png": "ends in .html",
    "explore run": "manifest.json",
    "plot zoo:warehouse-even --out plan.txt": "plan.txt: that is a file: name a folder",
    "train quick --out zoo:mine": "zoo:mine: names that begin with zoo: ship with qdenv",
    # Numbers that make no simulation.
    "simulate plan.txt --agents 0": "agents must be at least 1, not 0",
    "simulate plan.txt --agents -3": "agents must be at least 1, not -3",
    "simulate plan.txt --agents 900": "free cells",
    "simulate plan.txt --agents 99999999999": "agents must be at most",
    "sweep plan.txt --agents 2,900": "the layout has 71",
    "compare plan.txt --agents 1,1,1": "names a number twice",
    "scalability plan.txt --agents 80,90": "80 agents need as many free cells, the layout has 71",
    "simulate plan.txt --agents 9 --timesteps 2147483648": "must be at most",
    "simulate plan.txt --agents 9 --seconds-per-step nan": "per-step must be",
    "simulate plan.txt --agents 5 --timesteps 0": "timesteps must be at least 1, not 0",
    "simulate plan.txt --agents 5 --seeds 0": "at least one seed",
    "simulate plan.txt --agents 5 --seeds 99999999999": "seeds",
    "simulate plan.txt --agents 5 --seeds 3,3": "names a seed twice",
    "simulate maze.txt --agents 5": "no fleet",
    "replay nowhere.txt": "cannot be read",
    "replay plan.txt --agents 900": "free cells",
    "replay plan.txt --agents 0": "agents must be at least 1, not 0",
    "replay plan.txt --agents 5 --timesteps 99999999": "simulate at most",
    "replay plan.txt --agents 5 --timesteps 9999999": "replay at most 4000000 timesteps",
    "replay plan.txt --agents 5 --seed -1": "seed must be at least 0, not -1",
    "replay plan.txt --agents 5 --seeds 3": "did you mean --seed?",
    "replay plan.txt --agents 5 --planner dijkstra": "unknown planner 'dijkstra'",
    "replay plan.txt --agents 5 --out page.png": "ends in .html",
    "replay plan.txt --agents 5 --gif run.mp4": "ends in .gif",
    "replay plan.txt --agents 5 --mp4 run.png": "ends in .mp4",
    "replay plan.txt --agents 5 --gif --first 9 --last 9": "give timesteps, the first before",
    "replay plan.txt --agents 5 --last 50": "are for films: add --gif or --mp4",
    "replay plan.txt --agents 5 --timesteps 9 --gif --first 9": "the run ends at timestep 9",
    "replay maze.txt --agents 5": "one agent walks in a maze: leave --agents out",
    "replay maze.txt --planner pbs": "mazes have no planner",
    "replay maze.txt --timesteps 0": "timesteps must be at least 1, not 0",
    "evaluate-agent maze.txt --gif a.mp4": "ends in .gif",
    "sweep plan.txt --agents 50:10": "agents '50:10'",
    "sweep plan.txt --agents 5:1:-1": "numbers must be above zero, and ranges must",
    "sweep plan.txt --agents 1:99999999999": "choose a larger step",
    "compare plan.txt --agents 1-5": "write 200, or 50,100, or 50:400:50",
    **{
        f"{command} {mistake}": said
        for command in ("compare", "scalability")
        for mistake, said in {
            "nowhere.json": "nowhere.json: cannot be read",
            "plan.txt --agents 900": "plan: 900 agents",
            "plan.txt --agents many": "write 200, or 50,100",
            "plan.txt --domain manufacturing": "unknown tile",
            "plan.txt --domain moon": "unknown domain",
            "plan.txt --planner moon": "unknown planner",
            "plan.txt --seeds 0": "at least one seed",
            "plan.txt --timesteps 0": "timesteps must be at least 1, not 0",
        }.items()
    },
    "scalability": "at least one layout",
    "scalability plan.txt --agents 500": "500 agents need as many free cells",
    "repair plan.txt --shelves 70": "no repair exists",
    "repair plan.txt --shelves -1": "-1 shelves: give 0 or more",
    "check plan.txt --shelves -1": "-1 shelves: give 0 or more",
    # Searches that cannot succeed.
    "train quick --agents 240": "do not fit",
    "train quick --shelves 1000": "the number of shelves must be at least 1000",
    "train quick --evaluations 0": "evaluations must be at least 1",
    "train quick --archive 0 40 20": "has 2, connected shelf components",
    "train quick --archive 40 0 20 0 1 20": "is empty",
    "train quick --rows 99999": "choose 1 to 1000",
    "train quick --rows 2": "too small",
    "train quick --ahead 1001": "ahead must be at most 1000, not 1001",
    "train quick --seed 9999999999": "seed must be at most 2147483647, not 9999999999",
    "simulate plan.txt --seconds-per-step 0": "seconds-per-step must be above 0, not 0.0",
    "train quick --simulations 0": "simulations must be at least 1",
    "train quick --checkpoint-every 0": "checkpoint-every must be at least 1",
    "train quick --alpha nan": "alpha must be a finite number",
    "train quick --steps -3": "steps must be at least 1, not -3",
    "train quick --kernel-sizes 2": "odd",
    "train quick --kernel-sizes 3 3 3 3 3 3 3 3 3 3 3": "one to ten",
    "train quick --algorithm cma-mae-screened --strategy PGPE": "use iso",
    f"series zoo:warehouse-even --sizes 9x{'9' * 5000}": "rows and columns like 57x58",
    "train quick --hidden 0": "hidden must be at least 1, not 0",
    "train-agent --steps 0": "steps must be at least 1, not 0",
    "train-agent --report-every 0": "report-every must be at least 1, not 0",
    "train-agent --levels.textured 1.5": "textured must be at most 1, not 1.5",
    "train-agent --rate nan": "rate must be a finite number, not nan",
    "train-agent --resume --out agent --steps 50": "more steps are configured already",
    "resume agent --evaluations 5": "is not the run of one search: leave --evaluations out",
    "evaluate-agent maze.txt --horizon -5": "timesteps must be at least 1, not -5",
    "evaluate-agent plan.txt": "the agent walks in mazes",
    "evaluate-agent maze.txt --random-mazes 1": "--random-mazes 1: give 2 to 10,000",
    "evaluate-agent maze.txt --out random.csv": "add --random-mazes 100",
    "evaluate-agent maze.txt --random-mazes 5 --out random.json": "ends in .csv",
    "evaluate-agent maze.txt --random-mazes 5 --out taken.csv": "taken: that is a file",
    "evaluate-agent maze.txt --random-mazes 5 --reference-batching": "leave --random-mazes out",
    # Pictures and pages that cannot be.
    "simulate plan.txt --agents 5 --width page": "add --plot",
    "sweep plan.txt --agents 5 --width narrow": "write column (3.5 inches), page (7.2)",
    "plot run --width 1": "inches from 2 to 40",
    "plot": "at least one folder of a run",
    "plot zoo:warehouse-even zoo:maze-walls": "have different objectives",
    "plot run --format gif": "choose one of png, svg, pdf",
    "report": "at least one layout file or run",
    "report nowhere.txt": "cannot be read",
    "report plan.txt maze.txt": "report on one domain at a time",
    "report plan.txt plan.txt": "name each layout and run once",
    "report plan.txt --agents 900": "free cells",
    "report plan.txt --agents 50:10": "agents '50:10'",
    "report maze.txt --agents 5": "leave --agents out",
    "report maze.txt --planner pbs": "leave --planner, --effort and --no-stop out",
    "report maze.txt --seeds 3": "leave --seeds out",
    "report plan.txt --out r.pdf": "ends in .html",
    "report plan.txt --out plan.txt": "ends in .html",
    # Results that would destroy something.
    "layout human --rows 20 --cols 20 --out h.png": "ends in .json",
    "layout tile plan.txt --rows 5 --cols 5": "smaller than the layout it repeats",
    "layout tile thin.txt --rows 9 --cols 9 --domain warehouse-even": "5 x 4: warehouse-even",
    "layout human --rows 20 --cols 20 --out sealed.json": "the file is read-only",
    "simulate plan.txt --agents 5 --plot p.gif": "ends in .png",
    "layout human --rows 10000 --cols 10000": "more than 1000 rows or",
    "layout human --rows 99999999999 --cols 20": "more than 1000 rows or",
    "layout human --rows -5 --cols 20": "give 1 row and 1 column or more",
    "layout tile plan.txt --rows 1001 --cols 20": "more than 1000 rows",
    "layout tile plan.txt --rows 20 --cols 20 --out h.png": "ends in .json",
    "render plan.txt --out p.gif": "ends in .png or .svg or .pdf",
    "render plan.txt --out p.json": "ends in .png or .svg or .pdf",
    "convert plan.txt plan.txt": "that is what is read",
    "convert plan.txt a.doc": "give a name that ends in .json",
    "convert plan.txt a.scen": "write a .map",
    "convert plan.txt a.json --format lorr": "write a .map",
    "repair plan.txt --out x.png": "ends in .json or .txt or",
    "repair plan.txt --out x.map": "ends in .json or .txt or",
    "export zoo:warehouse-even --out x.png": "ends in .csv or .parquet",
    "export zoo:warehouse-even --out plans": ".csv or .parquet",
    "repair plan.txt --out plan.txt": "that is what is read",
    "simulate plan.txt --agents 2 --demand odds.csv --paths odds.csv": "that is what is read",
    "repair plan.txt --keep w+uneven.json --out uneven.json": "that is what is read",
    "simulate plan.txt --agents 2 --demand odds.csv,plan.txt --json plan.txt": "what is read",
    "check plan.txt --keep w+uneven.json --json uneven.json": "that is what is read",
    "sweep plan.txt --agents 2 --demand odds.csv --out odds.csv": "that is what is read",
    "compare plan.txt --agents 2 --demand odds.csv --runs odds.csv": "that is what is read",
    "convert plan.txt uneven.json --guidance uneven.json": "that is what is read",
    "repair plan.txt --diff x.xyz": "ends in .png",
    "compare plan.txt --out c.png": "ends in .csv",
    "simulate plan.txt --plot --json picture.png": "picture",
    "repair plan.txt --out a.json --json a.json": "named twice",
    "compare plan.txt --agents 2 --out c.csv --runs agent/../c.csv": "named twice",
    "series zoo:warehouse-even --sizes 9x12 9x12": "size 9x12 twice",
    "simulate plan.txt --agents 9 --json plan.txt": "that is what is read",
    "check plan.txt --json c.svg": "a picture's name",
    "train quick --run-dir run": "holds a run already",
    "train quick --out plan.txt/run": "plan.txt is a file): choose another place",
    "train-agent --out plan.txt": "that is a file",
    "guide plan.txt --robots 2 --out plan.txt": "that is a file: name a folder",
    "improve plan.txt --robots 2 --out plan.txt": "that is a file: name a folder",
    "train quick --seed -1": "seed -1: give 0 or more",
    "sweep plan.txt --agents 5 --out a.json": "ends in .csv",
    "resume run": "manifest.json",
    "surrogate run": "manifest.json",
    "surrogate run --size huge": "choose one of small, published",
    "surrogate run --epochs 0": "epochs must be at least 1",
    "surrogate run --seeds 2,2": "names a seed twice",
    "surrogate run --seeds 0": "seeds '0'",
    "surrogate run --out s.png": "ends in .csv",
    "repair plan.txt --keep ragged.txt": "ragged.txt",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("mistakes")
    (folder / "plan.txt").write_text("\n".join(PLAN))
    (folder / "odds.csv").write_text("1,1,1,1,1,1,1,1,1,1,1\n" * len(PLAN))
    (folder / "ragged.json").write_text('["...........", "..."]')
    (folder / "ragged.txt").write_text("...........\n...\n")
    (folder / "strange.txt").write_text("....\n....\n.?..\n")
    (folder / "empty.txt").write_text("")
    (folder / "no_layout.json").write_text("{}")
    (folder / "thin.txt").write_text("....\n" * 5)
    (folder / "sealed.json").touch(0o444)
    (folder / "taken").touch()
    (folder / "maze.txt").write_text("XXXXX\nX   X\nX X X\nX   X\nXXXXX\n")
    rows = ", ".join(f'"{row}"' for row in PLAN)
    (folder / "uneven.json").write_text(f'{{"domain": "warehouse-uneven", "layout": [{rows}]}}')
    (folder / "agent").mkdir()
    (folder / "agent/config.json").write_text('{"steps": 100}')
    (folder / "agent/checkpoint.npz").touch()
    (folder / "run").mkdir()
    (folder / "run/config.json").write_text("{}")
    return folder


@pytest.mark.parametrize("line", MISTAKES)
def test_a_mistake_is_answered_in_one_line_and_leaves_nothing(line, folder, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    never = lambda *given, **more: pytest.fail("something was simulated")  # noqa: E731
    monkeypatch.setattr("qdenv.study.engine._program", never)
    before = sorted(Path().rglob("*"))
    assert run(line.split()) == 2
    said = capsys.readouterr()
    assert said.err.startswith("qdenv: ") and said.err.count("\n") == 1, said.err
    assert MISTAKES[line] in said.err
    assert said.out == ""
    assert sorted(Path().rglob("*")) == before
