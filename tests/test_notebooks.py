"""Every notebook runs from top to bottom, and shows the pictures it promises."""

import json
import re
import runpy
from collections.abc import Iterator
from pathlib import Path

import nbformat
import pytest
from jupyter_client import KernelManager

ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
STORE = runpy.run_path(str(ROOT / "notebooks" / "store.py"))
PICTURES = {
    "00_the_loop": 7,
    "01_python": 6,
    "02_environment": 2,
    "03_archive": 4,
    "04_floor_plan": 2,
    "05_search": 3,
    "06_mazes": 2,
}
PAGES = {"03_archive": 1, "04_floor_plan": 2, "06_mazes": 1}  # explorers, replays, reports
LARGEST = 600_000  # bytes, with the outputs


def count(notebook, sign: str) -> int:
    """Count what outputs hold of something inside of their HTML."""
    outputs = [
        output.get("data", {})
        for cell in notebook.cells
        if cell.cell_type == "code"
        for output in cell.outputs
    ]
    pages = [data.get("text/html", "") for data in outputs]
    if sign == "<img":
        framed = sum(page.count(sign) for page in pages if "<iframe" not in page)
        return framed + sum("image/png" in data for data in outputs)
    return sum(page.count(sign) for page in pages)


@pytest.fixture(scope="module")
def kernel() -> Iterator[KernelManager]:
    """One kernel for all: packages are imported, and functions compiled, once."""
    manager = KernelManager()
    manager.start_kernel()
    yield manager
    manager.shutdown_kernel(now=True)


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs(path, kernel, tmp_path):
    notebook = nbformat.read(path, as_version=4)
    for cell in notebook.cells:  # shorter searches, and what follows from them: the same cells
        cell.source = re.sub(r"\bevaluations=\d+", "evaluations=25", cell.source)
        cell.source = re.sub(r"\b(mazes|runs)=\d+", r"\1=2", cell.source)
    fresh = f"%reset -f\n%cd -q {tmp_path}"  # no name of another notebook is known
    notebook.cells.insert(0, nbformat.v4.new_code_cell(fresh))
    notebook = STORE["execute"](notebook, str(tmp_path), km=kernel)
    assert count(notebook, "<img") >= PICTURES[path.stem]
    assert count(notebook, "<iframe") == PAGES.get(path.stem, 0)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_stored_with_its_outputs_and_names_no_machine(path):
    text = path.read_text()
    assert len(text) < LARGEST
    notebook = nbformat.read(path, as_version=4)
    assert count(notebook, "<img") >= PICTURES[path.stem]
    first = next(cell for cell in notebook.cells if cell.cell_type == "code")
    assert first.source == STORE["INSTALL"]  # the one way to install it
    words = re.sub(r'"image/png": ".*?"|base64,[^"]*', "", text)
    assert not re.findall(r"/(?:tmp|home|root|work)/", words)


@pytest.mark.parametrize(
    ("made", "chosen"),
    [
        (["qdenv-0.1.0-py3-none-any.whl"], "qdenv-0.1.0-py3-none-any.whl"),
        (["qdenv-main.zip"], "qdenv-main.zip"),
        (["qdenv/types.py", "notebooks/x.ipynb"], "."),
    ],
)
def test_the_install_cell_finds_a_wheel_a_zip_and_a_checkout(made, chosen, tmp_path, monkeypatch):
    for name in made:
        (tmp_path / name).parent.mkdir(exist_ok=True, parents=True)
        (tmp_path / name).touch()
    inside = tmp_path / "notebooks"
    monkeypatch.chdir(inside if inside.exists() else tmp_path)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    asked = re.sub(r"%pip install -q (.*)", r"wanted = f\1", STORE["INSTALL"])
    known: dict = {}
    exec(asked, known)
    assert known["wanted"] == f"{tmp_path / chosen}[data,viz]"


def test_without_anything_to_install_the_cell_says_what_to_upload(folder, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    asked = STORE["INSTALL"].replace("%pip install -q", "wanted =")
    with pytest.raises(AssertionError, match="upload a wheel or a zip"):
        exec(asked, {})


def prose_of(path: Path) -> str:
    if path.suffix == ".md":
        return path.read_text()
    cells = json.loads(path.read_text())["cells"]
    return "\n".join("".join(c["source"]) for c in cells if c["cell_type"] == "markdown")


PAGES_OF_TEXT = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "notebooks").rglob("*.md")]


@pytest.mark.parametrize("path", [*PAGES_OF_TEXT, *NOTEBOOKS], ids=lambda path: path.stem)
def test_links_lead_somewhere(path):
    text = prose_of(path)
    assert "github.com/qdenv" not in text  # nobody has put it there yet
    for target in re.findall(r"\]\((?!https?:|#)([^)\s#]+)", text):
        # In the book a notebook's link is its name alone.
        named = [path.parent / target, (path.parent / target).with_suffix(".ipynb")]
        assert any(one.exists() for one in named), target
