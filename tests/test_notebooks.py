"""The notebooks run, and are stored with what they show.

After a change, run `jupyter execute --inplace notebooks/*.ipynb` to store it again.
"""

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient
from nbformat import NotebookNode

FOLDER = Path(__file__).parent.parent / "notebooks"
MOST_BYTES = 300_000
SECONDS = 300  # for one cell, on a machine that does other things, too


def read(name: str) -> NotebookNode:
    return nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)


def code(notebook: NotebookNode) -> list[NotebookNode]:
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def kinds(notebook: NotebookNode) -> list[set[str]]:
    """What sort of outputs each cell has: the types of data, or the name of a stream."""
    return [
        {key for out in cell.outputs for key in out.get("data", {out.get("name", "error"): ""})}
        for cell in code(notebook)
    ]


def test_all_are_known() -> None:
    assert {path.stem for path in FOLDER.glob("*")} == {"first_skill", "own_action", "own_world"}


@pytest.mark.parametrize(
    "name",
    [
        *(pytest.param(n, marks=pytest.mark.hostile) for n in ("first_skill", "own_action")),
        "own_world",
    ],
)
def test_a_notebook_runs_and_is_stored_with_its_outputs(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = FOLDER / f"{name}.ipynb"
    assert path.stat().st_size < MOST_BYTES
    stored = read(name)
    assert [cell.execution_count for cell in code(stored)] == list(range(1, len(code(stored)) + 1))
    assert any("image/png" in some for some in kinds(stored))
    assert not [some for some in kinds(stored) if "error" in some or "stderr" in some]
    assert str(Path.home()) not in path.read_text()

    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    again = read(name)
    for cell in code(again):
        cell.outputs, cell.execution_count = [], None
    client = NotebookClient(again, timeout=SECONDS, resources={"metadata": {"path": str(tmp_path)}})
    client.execute()  # which raises where a cell does
    assert kinds(again) == kinds(stored)
