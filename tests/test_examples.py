"""The examples run."""

import importlib.util
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("*.py"))


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda p: p.stem)
def test_example(path, tmp_path):
    if path.stem == "rasterised":
        _need_opengl()
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    output = tmp_path / {"exitance_for_any_renderer": "mesh.ply"}.get(path.stem, "picture.png")
    module.main(str(output), *{"two_words": [4], "rasterised": [192]}.get(path.stem, []))
    assert output.stat().st_size > 1000
    if output.suffix == ".png":
        assert np.array(mi.Bitmap(str(output))).mean() > 10


def _need_opengl() -> None:
    """Skip where nothing rasterises."""
    moderngl = pytest.importorskip("moderngl")
    try:
        moderngl.create_context(standalone=True, backend="egl").release()
    except Exception as error:
        pytest.skip(f"no OpenGL without a window: {error}")
