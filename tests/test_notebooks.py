"""The notebooks run from start to end without other output, and print every number of their results."""

import re
from pathlib import Path

import jax
import nbformat
import pytest
from nbclient import NotebookClient

ROOT = Path(__file__).parent.parent
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
TUTORIALS = sorted((ROOT / "docs" / "tutorials").glob("*.ipynb"))
GALLERY = ROOT / "docs" / "gallery.ipynb"
ALL = [*NOTEBOOKS, *TUTORIALS, GALLERY]
NUMBER = re.compile(r"\d+(?:[.,]\d+)*")
RESULTS = "## Results"


def outputs_of(notebook) -> list:
    return [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]


def printed(notebook) -> str:
    return "".join(output.text for output in outputs_of(notebook) if output.output_type == "stream")


def numbers_in(text: str) -> set[str]:
    return {number.replace(",", "") for number in NUMBER.findall(text)}


def check_outputs(notebook, figures: int) -> None:
    """Check that every cell ran, in order, with figures, without failures, and with nothing on stderr."""
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in code] == list(range(1, len(code) + 1))
    outputs = outputs_of(notebook)
    assert {output.output_type for output in outputs} <= {"stream", "display_data", "execute_result"}
    assert all(output.name == "stdout" for output in outputs if output.output_type == "stream")
    assert sum("image/png" in output.get("data", {}) for output in outputs) >= figures


def check_results(notebook) -> None:
    """Check that every number of the last cell was printed above it or is in the code."""
    last = notebook.cells[-1].source
    assert last.startswith(RESULTS)
    code = " ".join(cell.source for cell in notebook.cells if cell.cell_type == "code")
    assert not numbers_in(last) - numbers_in(printed(notebook) + " " + code)


def check(path: Path, notebook) -> None:
    """Check the outputs of every notebook, and the results of all but the gallery."""
    check_outputs(notebook, {GALLERY: 8}.get(path, 2 if path in NOTEBOOKS else 0))
    if path != GALLERY:
        check_results(notebook)


@pytest.mark.parametrize("paths", [NOTEBOOKS, TUTORIALS], ids=["notebooks", "tutorials"])
def test_there_are_notebooks(paths):
    assert len(paths) >= 5
    numbers = [int(path.name.split("_")[0]) for path in paths]
    assert numbers == list(range(1, len(numbers) + 1))


def test_a_picture_of_the_gallery_takes_some_ten_lines():
    cells = [cell for cell in nbformat.read(GALLERY, 4).cells if cell.cell_type == "code"]
    for cell in cells[1:]:
        assert len([line for line in cell.source.splitlines() if line.strip()]) <= 14
        assert any("image/png" in output.get("data", {}) for output in cell.outputs)


@pytest.mark.parametrize("path", ALL, ids=lambda path: path.stem)
def test_as_committed(path):
    notebook = nbformat.read(path, 4)
    nbformat.validate(notebook)
    check(path, notebook)
    assert not re.search(r"/(home|root|tmp|Users|work)/", printed(notebook))
    assert path.stat().st_size < (500_000 if path in NOTEBOOKS else 250_000)


@pytest.mark.slow
@pytest.mark.parametrize("path", ALL, ids=lambda path: path.stem)
def test_it_runs_and_still_says_so(path, monkeypatch):
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", jax.config.jax_compilation_cache_dir)
    # As users compile: where a search ends may hang on the last bits.
    monkeypatch.setenv("XLA_FLAGS", "")
    notebook = nbformat.read(path, 4)
    client = NotebookClient(notebook, timeout=900, kernel_name="python3", resources={"metadata": {"path": path.parent}})
    client.execute()
    check(path, notebook)
