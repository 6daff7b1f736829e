"""Execute notebooks and store them with their outputs.

    python notebooks/store.py                  # all of them
    python notebooks/store.py notebooks/03_archive.ipynb

The cell that installs qdenv stands here once and is put into every notebook.
"""

import sys
import tempfile
from pathlib import Path
from typing import Any

import nbformat
from nbconvert.preprocessors import ExecutePreprocessor

HERE = Path(__file__).parent
REPOSITORY = ""  # the address that pip installs from, once there is a public one
WORD = "# Installs qdenv"
INSTALL = f"""{WORD} where it is missing: from the checkout around this notebook, or from a wheel
# or a zip of the repository that was uploaded beside it (in Colab: the folder symbol at the left).
from importlib.util import find_spec
from pathlib import Path

if find_spec("qdenv") is None:
    here = Path.cwd()
    checkouts = [folder for folder in (here, *here.parents) if (folder / "qdenv/types.py").exists()]
    found = [*sorted(here.glob("qdenv*.whl")), *sorted(here.glob("qdenv*.zip")), *checkouts]
    place = str(found[0]) if found else "{REPOSITORY}"
    assert place, "upload a wheel or a zip of qdenv beside this notebook, then run this cell again"
    %pip install -q "{{place}}[data,viz]\""""
FRAME = "<iframe"  # pages are large and do not run where notebooks are only shown


def with_install(notebook: nbformat.NotebookNode) -> nbformat.NotebookNode:
    """Put the cell that installs qdenv before the first code, in place of an older one."""
    cells = [cell for cell in notebook.cells if not cell.source.startswith(WORD)]
    first = next(place for place, cell in enumerate(cells) if cell.cell_type == "code")
    cell = nbformat.v4.new_code_cell(INSTALL, id="install")
    notebook.cells = [*cells[:first], cell, *cells[first:]]
    return notebook


def execute(notebook: nbformat.NotebookNode, folder: str, **more: Any) -> nbformat.NotebookNode:
    """Run a notebook from top to bottom in a folder; an error in a cell is raised."""
    runner = ExecutePreprocessor(timeout=600, kernel_name="python3")
    runner.preprocess(notebook, {"metadata": {"path": folder}}, **more)
    if runner.kc:  # to a kernel that was given, and goes on
        runner.kc.stop_channels()
    return notebook


def for_storing(notebook: nbformat.NotebookNode) -> nbformat.NotebookNode:
    """Leave out what does not belong into a file that is read: pages, times, warnings."""
    for cell in notebook.cells:
        cell.metadata.pop("execution", None)
        if cell.cell_type == "code":
            cell.outputs = [
                one
                for one in cell.outputs
                if FRAME not in one.get("data", {}).get("text/html", "")
                and one.get("name") != "stderr"
            ]
    return notebook


def main(paths: list[str]) -> None:
    """Execute and store some notebooks, or all."""
    for path in [*map(Path, paths)] or sorted(HERE.glob("*.ipynb")):
        notebook = with_install(nbformat.read(path, as_version=4))
        with tempfile.TemporaryDirectory() as folder:
            nbformat.write(for_storing(execute(notebook, folder)), path)
        print(path)


if __name__ == "__main__":
    main(sys.argv[1:])
