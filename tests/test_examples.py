"""The examples run."""

import importlib.util
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("*.py"))


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda p: p.stem)
def test_example(path, tmp_path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    output = tmp_path / {"two_words": "picture.png", "lamp_goes_around": "frames.png"}.get(path.stem, "mesh.ply")
    module.main(str(output), 4) if path.stem == "two_words" else module.main(str(output))
    assert output.stat().st_size > 1000
    if output.suffix == ".png":
        assert np.array(mi.Bitmap(str(output))).mean() > 10
