"""How the book is built: `sphinx-build -W notebooks build/book` (with the extra `docs`).

Notebooks are stored executed and are not executed again. The pages of `reference/` that list the
Python API and the commands are written here, from the operations themselves.
"""

import contextlib
import importlib.metadata
import inspect
import io
import logging
import os
import pkgutil
import re
import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent

project = "qdenv"
author = "The qdenv developers"
copyright = "2026, the qdenv developers"
release = importlib.metadata.version("qdenv")

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode"]
html_theme = "furo"
html_title = "qdenv"
exclude_patterns = ["store.py"]
nb_execution_mode = "off"
myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 3
# Links to source files lead out of the book.
suppress_warnings = ["myst.xref_missing"]
autodoc_member_order = "bysource"
autodoc_typehints = "none"
napoleon_google_docstring = True
default_role = "code"  # of `names` in docstrings


PACKED = '<script type="application/gzip" id="packed-plotly">'
SHARED = """const library = document.createElement("script");
library.type = "application/gzip"; library.id = "packed-plotly";
library.textContent = "{}";
document.head.append(library);
"""


# What public functions take and return: documented with them.
RECORDS = {
    "ops.options": ["RunOptions", "FleetOptions", "StudyOptions", "GuideOptions", "ImproveOptions"],
    "ops.output": ["Result", "Table"],
    "study.table": ["Row"],
    "ops.improve": ["Improvement"],
    "view.page": ["Page"],
    "run.archive": ["SavedArchive", "Elite"],
    "run.experiment": ["Experiment"],
    "pipeline": ["Pipeline"],
    "types": ["Evaluation"],
    "repairs.audit": ["Violation"],
    "registry": ["Registry"],
    "simulation.mapf.environment": ["Environment", "EnvironmentState", "Observation", "Timestep"],
}


def comments_of(record: type) -> dict[str, str]:
    """Return what the comments behind the fields of a class, or above them, say of each."""
    from sphinx.pycode import ModuleAnalyzer

    source = inspect.getsource(sys.modules[record.__module__])
    # What Sphinx takes for documentation.
    source = re.sub(r"^( +(?:[^#\n]*  )?)# ", r"\1#: ", source, flags=re.MULTILINE)
    found = ModuleAnalyzer.for_string(source, record.__module__).find_attr_docs()
    return {name: " ".join(text) for (home, name), text in found.items() if home == record.__name__}


def explain(app: Any, what: str, name: str, member: Any, options: Any, lines: Any) -> None:
    """Add the fields of a record to its documentation; set options of commands as code."""
    if what == "class":
        lines += [f":param {field}: {text}" for field, text in comments_of(member).items()]
        lines += [""]
    option = re.compile(r"(`+[^`]*`+)|(?<![\w-])(--[a-z][\w-]*)")
    lines[:] = [option.sub(lambda one: one[1] or f"`{one[2]}`", line) for line in lines]


def write_python() -> str:
    """List the public names, and records that they take and return, by their home modules."""
    import qdenv
    import qdenv.registry

    homes: dict[str, list[str]] = {}
    for line in (Path(qdenv.__file__).parent / "__init__.pyi").read_text().splitlines():
        if line.startswith("from ."):
            home, name = line.removeprefix("from .").split(" import ")
            homes.setdefault(home, []).append(name.split(" as ")[0])
    text = [
        "# Python",
        "",
        "The names of the first part are in `qdenv` itself: `qdenv.simulate`. Letters in shapes: B "
        "layouts, S simulations, H rows, W columns, K kinds of tile, P parameters of a generator, "
        "A agents, T timesteps, M measures, C cells of an archive. A cell is row * W + column. "
        "Places of `out` by default are those of commands: in Python `train`, `guide`, `improve`, "
        "`train_agent`, `convert_agent`, `plot` and the frames of `generate` have one, and others "
        "write nothing unless it is named.",
        "",
    ]
    parts = {f"qdenv.{home}": (home, names) for home, names in homes.items()}
    parts |= {f"Records of qdenv.{home}": (home, names) for home, names in RECORDS.items()}
    for title, (home, names) in parts.items():
        text += [f"## {title}", ""]
        for name in names:
            member = pkgutil.resolve_name(f"qdenv.{home}:{name}")
            if isinstance(member, type) or callable(member):
                is_class = isinstance(member, type)
                kind = "class" if is_class else "function"
                text += ["```{eval-rst}", f".. auto{kind}:: qdenv.{home}.{name}"]
                if is_class:  # fields are explained as parameters
                    fields = ", ".join(comments_of(member))
                    text += ["   :members:", f"   :exclude-members: {fields}"]
                text += ["```", ""]
            else:
                known = member.names() if isinstance(member, qdenv.registry.Registry) else member
                text += [f"`{name}`: {', '.join(known)}", ""]
    return "\n".join(text)


def write_commands() -> str:
    """Print the help of every command."""
    from qdenv.cli.main import COMMANDS, run

    text = [
        "# Commands",
        "",
        "What `qdenv COMMAND --help-all` prints; `--help` alone leaves out what few people need.",
        "",
    ]
    for name in COMMANDS:
        shown = io.StringIO()
        with contextlib.redirect_stdout(shown), contextlib.suppress(SystemExit):
            run([*name.split(), "--help-all"])
        text += [f"## qdenv {name}", "", "```text", shown.getvalue().rstrip(), "```", ""]
    return "\n".join(text)


def write_reference(app: Any) -> None:
    """Write the generated pages, where they changed."""
    os.environ.setdefault("COLUMNS", "100")
    for name, text in (("python", write_python()), ("commands", write_commands())):
        path = HERE / "reference" / f"{name}.md"
        if not path.exists() or path.read_text() != text:
            path.write_text(text)


def write_live(app: Any, exception: Exception | None) -> None:
    """Write an explorer of each archive of the zoo, and a replay of its best layout."""
    import qdenv
    from qdenv.shipped import names

    logging.getLogger("qdenv").setLevel("WARNING")  # of what is found, only pages are of interest
    folder = Path(app.outdir) / "live"
    folder.mkdir(exist_ok=True)
    for domain in names():
        best = qdenv.RunDirectory.open(f"zoo:{domain}/best")
        page = qdenv.explore(f"zoo:{domain}").html
        # The library that draws is most of a page: here a script puts it there, which all share.
        begin, _, rest = page.partition(PACKED)
        library, _, rest = rest.partition("</script>")
        (folder / "library.js").write_text(SHARED.format(library.strip()))
        page = f'{begin}<script src="library.js"></script>{rest}'
        (folder / f"{domain}-archive.html").write_text(page)
        layout = qdenv.Layout(best.best.layout, qdenv.make_domain(best.config.evaluation.domain))
        plan = qdenv.read_plan(layout)._replace(name=f"{domain}: the best of the zoo")
        qdenv.replay(plan, timesteps=200).save(folder / f"{domain}-best.html")


def setup(app: Any) -> None:
    """Write the reference before the pages are read, and the live pages at the end."""
    logging.getLogger("jax").setLevel("WARNING")  # it tells which devices there are not
    app.connect("builder-inited", write_reference)
    app.connect("autodoc-process-docstring", explain)
    app.connect("build-finished", write_live)
