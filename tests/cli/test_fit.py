"""``pellucid fit`` at the terminal; what it finds is tested in ``tests/fitting``."""

from types import SimpleNamespace

import numpy as np


def test_every_file_that_is_written_is_named(run, scene_file, tmp_path, monkeypatch):
    def write(path):
        path.write_text("{}")

    found = SimpleNamespace(write=write, differences=[np.zeros((2, 2, 3))] * 2, summary=lambda: ["a wax"])
    monkeypatch.setattr("pellucid.fitting.fit.fit", lambda *_, **__: found)
    output = run("fit", scene_file, "one.exr", "two.exr").output
    assert "wrote material.json, material_residual_0.exr, material_residual_1.exr\n" in output
    written = {path.name for path in tmp_path.iterdir()} - {scene_file.name}
    assert written == {"material.json", "material_residual_0.exr", "material_residual_1.exr"}
    assert "[default: material.json]" in " ".join(run("fit", "--help").output.split())
