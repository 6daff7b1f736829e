"""The command explore: a run's archive as a page to touch."""

from pathlib import Path

from qdenv.commands import output
from qdenv.commands.choices import RunFolder
from qdenv.commands.output import JsonFile, write_facts
from qdenv.progress import Bar
from qdenv.ranges import NonNegativeInt
from qdenv.run.directory import RunDirectory

PAGES = (".html",)


def explore(
    run_dir: RunFolder,
    growth: NonNegativeInt | None = None,
    out: Path | None = None,
    json_file: JsonFile = None,
) -> None:
    """Make a page on which a run's archive can be touched: layouts, numbers, growth.

    One file that opens in a browser, from disk, without a network.

    Args:
        run_dir: folder of the run.
        growth: how many elites the page shows growing, the best among them; unless given as many
            as fit into 12 MB.
        out: page to write; explorer.html unless given.
        json_file: where to write the facts; - for standard output.
    """
    run = RunDirectory.open(run_dir)
    place = output.place(out, "explorer.html", PAGES)
    # Only now: who is refused need not wait for what this imports.
    from qdenv.view.explorer import make_explorer

    with Bar("growing") as bar:
        page, facts = make_explorer(run, growth, bar)
    page.save(place.path)
    write_facts(json_file, "explore", facts, run=run_dir, growth=growth)
    print(
        f"{place}: {facts['elites']} elites, {facts['growth']} of them grow, "
        f"{facts['megabytes']:.1f} MB"
    )
