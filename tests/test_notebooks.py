"""Every notebook runs from top to bottom, and shows the pictures it promises."""

import json
import re
from pathlib import Path

import nbformat
import pytest
from nbconvert.preprocessors import ExecutePreprocessor

ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
PICTURES = {"00_the_loop": 7, "01_python": 6, "02_environment": 2}
LARGEST = 600_000  # bytes, with the outputs


def pictures_of(notebook) -> int:
    """Count the pictures in the outputs: whole ones, and those inside of HTML."""
    outputs = [
        output.get("data", {})
        for cell in notebook.cells
        if cell.cell_type == "code"
        for output in cell.outputs
    ]
    inside = sum(data.get("text/html", "").count("<img") for data in outputs)
    return inside + sum("image/png" in data for data in outputs)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs(path, tmp_path):
    notebook = nbformat.read(path, as_version=4)
    runner = ExecutePreprocessor(timeout=600, kernel_name="python3")
    runner.preprocess(notebook, {"metadata": {"path": str(tmp_path)}})  # raises on any error
    assert pictures_of(notebook) >= PICTURES[path.stem]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_stored_with_its_outputs_and_names_no_machine(path):
    text = path.read_text()
    assert len(text) < LARGEST
    assert pictures_of(nbformat.read(path, as_version=4)) >= PICTURES[path.stem]
    words = re.sub(r'"image/png": ".*?"|base64,[^"]*', "", text)
    assert not re.findall(r"/(?:tmp|home|root|work)/", words)


def prose_of(path: Path) -> str:
    if path.suffix == ".md":
        return path.read_text()
    cells = json.loads(path.read_text())["cells"]
    return "\n".join("".join(c["source"]) for c in cells if c["cell_type"] == "markdown")


@pytest.mark.parametrize("path", [ROOT / "README.md", *NOTEBOOKS], ids=lambda path: path.stem)
def test_links_lead_somewhere(path):
    text = prose_of(path)
    assert "github.com/qdenv" not in text  # nobody has put it there yet
    for target in re.findall(r"\]\((?!https?:|#)([^)\s#]+)", text):
        assert (path.parent / target).exists(), target
