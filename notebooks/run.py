"""Run the notebooks, those named or all, and keep what they give in them."""

import sys
from pathlib import Path

import nbformat
from nbclient import NotebookClient

named = map(Path, sys.argv[1:])
for path in [*named] or sorted(Path(__file__).parent.glob("*.ipynb")):
    notebook = nbformat.read(path, as_version=4)
    for cell in notebook.cells:
        cell.metadata.clear()  # times of earlier runs, which other programs leave there
    print(path.name)
    NotebookClient(notebook, record_timing=False, coalesce_streams=True).execute()
    nbformat.write(notebook, path)
