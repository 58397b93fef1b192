"""The notebooks run, and show the pictures that they were committed with."""

import base64
import io
import os
import sys
from pathlib import Path

import nbformat
import numpy as np
import PIL.Image
import pytest
from nbclient import NotebookClient

NOTEBOOKS = sorted((Path(__file__).parents[2] / "docs" / "notebooks").glob("*.ipynb"))
MOST_BYTES = 500_000


def pictures(notebook):
    """Decode the pictures that a notebook shows, in their order: ``(height, width, 3) float`` each, in [0, 255]."""
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    encoded = [output.data["image/jpeg"] for output in outputs if "image/jpeg" in output.get("data", {})]
    return [np.asarray(PIL.Image.open(io.BytesIO(base64.b64decode(data))), float) for data in encoded]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook(path, tmp_path, monkeypatch):
    assert path.stat().st_size < MOST_BYTES
    shown = pictures(nbformat.read(path, 4))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
    notebook = nbformat.read(path, 4)
    NotebookClient(notebook, timeout=120, kernel_name="python3", resources={"metadata": {"path": tmp_path}}).execute()
    rendered = pictures(notebook)
    assert shown and [picture.shape for picture in shown] == [picture.shape for picture in rendered]
    for before, now in zip(shown, rendered, strict=True):
        assert np.abs(before - now).mean() < 1, (
            "the notebook was committed with other pictures: run it again and save it"
        )
