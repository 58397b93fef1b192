import mitsuba as mi
import numpy as np
import pytest

from pellucid.cli.comparison import Result, composition, gain
from pellucid.metrics import relative_rmse


def read(path):
    return np.array(mi.Bitmap(str(path)))[..., :3]


def test_methods_are_measured_against_exact(run, scene_file, tmp_path):
    result = run("compare", scene_file, "-o", "both", "--methods", "two_pass,exact", "--max-error", "2")
    assert sorted(path.name for path in (tmp_path / "both").iterdir()) == [
        "compare.png",
        *("exact.exr", "exact.png", "two_pass.exr", "two_pass.png"),
    ]
    rows = {line.split()[0]: line for line in result.output.splitlines() if line.strip()}
    assert "reference" in rows["exact"]
    error = relative_rmse(read("both/two_pass.exr"), read("both/exact.exr"))
    assert 0 < error < 0.05
    assert f"{100 * error:.3g} %" in rows["two_pass"]
    assert read("both/compare.png").shape == (2 * 16, 2 * 24, 3)


def test_a_method_without_error_tolerance_is_its_own_twin(run, scene_file):
    result = run("compare", scene_file, "-o", "c.exr", "--methods", "exact,two_pass", "--max-error", "0")
    row = next(line for line in result.output.splitlines() if "two_pass" in line)
    assert float(row.split()[-4]) < 1e-4  # [%]: only the order of summation differs
    assert read("c.exr").shape == (32, 48, 3)


def test_the_reference_can_be_chosen(run, scene_file):
    result = run("compare", scene_file, "--methods", "sampled,two_pass", "--reference", "sampled")
    assert "reference" in next(line for line in result.output.splitlines() if line.strip().startswith("sampled"))
    assert "not among the methods" in run("compare", scene_file, "--reference", "best", code=2).stderr


def test_differences_are_amplified_to_about_white():
    truth = np.zeros((10, 10, 3))
    picture = truth + 0.004
    assert gain(picture, truth) == pytest.approx(200)
    assert gain(truth, truth) == 1
    assert gain(truth + 30, truth) == 1
    results = [Result("a", picture, 0, 0, 0), Result("b", truth, 0, 0, 0)]
    shown = composition(results, truth, [200.0, 1.0])
    assert shown.shape == (20, 20, 3)
    np.testing.assert_allclose(shown[10:, :10], 0.8)
    np.testing.assert_allclose(shown[:10, :10], 0.004)
    assert not shown[:, 10:].any()
