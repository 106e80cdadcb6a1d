"""The notebooks run as they stand, and hold the outputs of such a run."""

import sys
from pathlib import Path

import nbformat
import numpy as np
import pytest
from jupyter_client.kernelspec import KernelSpecManager
from jupyter_client.manager import AsyncKernelManager
from nbclient import NotebookClient
from nbformat import NotebookNode
from reference import ROOT

NOTEBOOKS = ROOT / "notebooks"
PATHS = sorted(NOTEBOOKS.glob("*.ipynb"))
ROOM = 200_000
"""Bytes that a notebook may have."""

QUICKEST = "3-the-basin"
"""The notebook that is executed among the tests that are not slow."""


def speed(path: Path) -> list[pytest.MarkDecorator]:
    return [] if path.stem == QUICKEST else [pytest.mark.slow]


each_notebook = pytest.mark.parametrize("path", PATHS, ids=lambda path: path.stem)


def read(path: Path) -> NotebookNode:
    return nbformat.read(path, as_version=4)


def printed(notebook: NotebookNode) -> list[str]:
    """The text that each code cell gives, in however many pieces; a figure has its size."""
    return ["".join(map(text_of, outputs)) for outputs in outputs_of(notebook)]


def text_of(output: NotebookNode) -> str:
    if output.output_type == "stream":
        return output.text
    return output.get("data", {}).get("text/plain", "")


def figures(notebook: NotebookNode) -> list[int]:
    """How many figures each code cell draws."""
    return [sum(map(is_figure, outputs)) for outputs in outputs_of(notebook)]


def is_figure(output: NotebookNode) -> bool:
    return "image/png" in output.get("data", {})


def outputs_of(notebook: NotebookNode) -> list[list[NotebookNode]]:
    return [cell.outputs for cell in notebook.cells if cell.cell_type == "code"]


def own_kernel() -> AsyncKernelManager:
    """A kernel of the interpreter that runs the tests, whatever kernels are installed."""
    return AsyncKernelManager(kernel_spec_manager=KernelSpecManager(kernel_dirs=[]))


AS_AT_FIRST = """
%reset -f
import os as _os
import jax as _jax, matplotlib.pyplot as _plt, numpy as _np
_jax.config.update("jax_enable_x64", False)
_plt.close("all")
_plt.rcdefaults()
_np.set_printoptions(**PRINTING)
_os.chdir(FOLDER)
%reset -f
"""
"""A notebook finds a kernel in which others have run as if none had; what they compiled is kept."""


@pytest.fixture(scope="module")
def kernel():
    """One for all notebooks, which have most of what they compile in common."""
    manager = own_kernel()
    yield manager
    client = NotebookClient(nbformat.v4.new_notebook(), km=manager)
    client.execute(cleanup_kc=True)  # as it does not where the manager is given


def test_there_are_eleven_notebooks_each_in_the_table():
    table = (NOTEBOOKS / "README.md").read_text()
    assert sorted(int(path.name.partition("-")[0]) for path in PATHS) == [*range(1, 12)]
    assert all(f"({path.name})" in table for path in PATHS)


def test_the_kernel_is_of_this_interpreter():
    assert own_kernel().format_kernel_cmd()[0] == sys.executable


@pytest.mark.parametrize(
    "path", [pytest.param(path, id=path.stem, marks=speed(path)) for path in PATHS]
)
def test_a_notebook_runs_and_gives_what_it_holds(path, tmp_path, kernel):
    notebook = read(path)
    held, drawn = printed(notebook), figures(notebook)
    first = AS_AT_FIRST.replace("FOLDER", repr(str(tmp_path)))
    first = first.replace("PRINTING", repr(np.get_printoptions()))
    notebook.cells.insert(0, nbformat.v4.new_code_cell(first))
    client = NotebookClient(
        notebook,
        km=kernel,
        timeout=600,  # seconds for a cell: the slowest, of networks, compiles for minutes
    )
    try:
        client.execute()
    finally:
        if client.kc is not None:
            client.kc.stop_channels()  # or its sockets stay open
    assert outputs_of(notebook)[0] == []
    del notebook.cells[0]
    assert printed(notebook) == held
    assert figures(notebook) == drawn and sum(drawn) > 0
    assert list(tmp_path.iterdir()) == []


@each_notebook
def test_a_notebook_is_small_and_of_no_machine(path):
    notebook, text = read(path), path.read_text()
    nbformat.validate(notebook)
    assert len(text.encode()) < ROOM
    assert notebook.metadata.kernelspec == {
        "display_name": "Python 3 (ipykernel)",
        "language": "python",
        "name": "python3",
    }
    assert set(notebook.metadata) == {"kernelspec", "language_info"}
    assert all(not cell.metadata for cell in notebook.cells)
    assert all(place not in text for place in (sys.prefix, str(Path.home()), str(NOTEBOOKS.parent)))


@each_notebook
def test_a_notebook_was_run_from_top_to_bottom(path):
    counts = [cell.execution_count for cell in read(path).cells if cell.cell_type == "code"]
    assert counts == list(range(1, len(counts) + 1))
