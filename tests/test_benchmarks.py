"""The options of the benchmarks: a quick look writes nothing, and nothing else is less than the whole."""

import ast
import re
from pathlib import Path
from types import SimpleNamespace

import mitsuba as mi
import numpy as np
import pytest

from pellucid.errors import PellucidError
from pellucid.methods.contract import Points
from pellucid.methods.single_pass.integrator import SinglePass
from support.equal_error import Errors, at_error
from support.many_workers import Run, of_light, of_pieces
from support.record import DOCS
from support.single_pass import Cuts
from support.single_pass_errors import given
from support.single_pass_tables import tables

FOLDER = Path(__file__).parents[1] / "benchmarks"
BENCHMARKS = sorted(path for path in FOLDER.glob("*.py") if "add_argument" in path.read_text())
WRITES = re.compile(r"\b(save|fill|write_text|savefig|insert|plot|tables)\(")
PARTS = {"--quick", "--only", "--tables", "--point", "--variant"}
"""Options that leave the documents alone, or write into them what the whole measurement finds."""


@pytest.mark.parametrize("path", BENCHMARKS, ids=lambda path: path.stem)
def test_no_option_writes_a_rough_result_into_the_documents(path):
    text = path.read_text()
    options = set(re.findall(r'add_argument\(\s*"(--[\w-]+)"', text))
    assert options <= PARTS
    if "--quick" in options and WRITES.search(text):
        assert _writes_under_quick(ast.parse(text)) == []


def _writes_under_quick(module: ast.Module) -> list[int]:
    """List the lines of the functions with the option where something is written though ``quick`` is set."""
    found = []
    for function in ast.walk(module):
        if (
            isinstance(function, ast.FunctionDef)
            and "quick" in ast.unparse(function)
            and function.name in ("main", "run")
        ):
            found += _unguarded(function.body)
    return found


def _unguarded(body: list[ast.stmt]) -> list[int]:
    lines: list[int] = []
    for statement in body:
        if isinstance(statement, ast.If) and re.fullmatch(r"not (arguments\.)?quick", ast.unparse(statement.test)):
            lines += _unguarded(statement.orelse)
            continue
        if isinstance(statement, ast.If) and re.fullmatch(r"(arguments\.)?quick", ast.unparse(statement.test)):
            lines += _unguarded(statement.body)
            if isinstance(statement.body[-1], ast.Return | ast.Continue):
                return lines  # the rest is not reached
            lines += _unguarded(statement.orelse)
            continue
        if isinstance(statement, ast.If) and ast.unparse(statement.test) == "arguments.tables":
            continue  # writes the tables from what is saved
        inner = [part for name in ("body", "orelse") for part in getattr(statement, name, [])]
        if inner:
            lines += _unguarded(inner)
        elif any(_writes(call) for call in ast.walk(statement) if isinstance(call, ast.Call)):
            lines.append(statement.lineno)
    return lines


def _writes(call: ast.Call) -> bool:
    """Tell whether a call writes a result: by its name, on its own or as a method."""
    name = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
    return name in ("save", "fill", "write_text", "savefig", "insert", "plot", "tables", "write_bytes")


def test_what_a_reference_takes_at_an_error_is_read_off_its_curve():
    """Along the power law that it follows, here ``rays ~ 1 / error``; and it is said where the curve ends before."""
    curve = [
        {"max_error": e, "max_cut": 1000, "rmse": e / 5, "shadow_rays": 1 / e, "irradiance": 2 / e}
        for e in (0.02, 0.1, 0.5)
    ]

    def at(error, end):
        return {
            key: pytest.approx(x)
            for key, x in zip(("max_error", "max_cut", "shadow_rays", "irradiance"), error, strict=True)
        }, end

    assert at_error(curve, 0.01) == at((0.05, 1000, 20, 40), "")
    assert at_error(curve, 1.0) == at((0.5, 1000, 2, 4), "<")
    assert at_error(curve, 1e-4) == at((0.02, 1000, 50, 100), ">")
    smaller = {"max_error": 0.02, "max_cut": 100, "rmse": 0.01, "shadow_rays": 5, "irradiance": 9}
    assert at_error([*curve, smaller], 0.01) == at((0.02, 100, 5, 9), "")


def test_rows_of_an_older_table_are_named_and_left_out(capsys):
    before = (DOCS / "benchmarks.md").read_text()
    tables({"teapot_table": {"polygons": 1}})
    assert "measure it with --only teapot_table" in capsys.readouterr().out
    assert (DOCS / "benchmarks.md").read_text() == before


def test_errors_of_references_are_found_through_the_noise_of_draws():
    """Two of 1 % and one of 5 %, where each draw alone is wrong by 10 %."""
    rng = np.random.default_rng(0)
    tight, other, loose = (rng.normal(2.0, 2.0 * error, (40_000, 3)) for error in (0.01, 0.01, 0.05))

    def drawn(difference):
        return tuple(difference + rng.normal(0, 0.2, difference.shape) for _ in range(2))

    first, second = Errors(2.0, (Cuts(0.02), Cuts(0.5)), [drawn(other - tight), drawn(loose - tight)]).curve()
    assert (first["rmse"], second["rmse"]) == (pytest.approx(0.01, rel=0.2), pytest.approx(0.05, rel=0.03))
    assert second["rmse_error"] < 0.001


def test_points_of_a_picture_get_their_exitance_in_whatever_order_bands_ask_for_them():
    """Two keys are equal, as they may be by chance. What the picture has not shown is refused."""
    place = mi.Point3f([0.5, 1.5, -0.0, 2.5], [0.0] * 4, [0.0] * 4)
    key = mi.UInt32([7, 1 << 31, 7, 3])
    points = Points(place, mi.Normal3f(place), mi.UInt32([1, 2, 1, 2]), mi.Float([1.0] * 4), key)
    numbers = [np.array([2, 0]), np.array([1, 3])]
    method = SinglePass()
    picture = SimpleNamespace(
        points=points, pixel=np.zeros(4), place=numbers, integrator=SimpleNamespace(method=method)
    )
    values = [np.array([[3.0] * 3, [1.0] * 3]), np.array([[2.0] * 3, [4.0] * 3])]
    with given(picture, values):
        known = picture.integrator.method
        for band in ([3, 0], [2, 1]):
            found = known.exitance(None, None, points.take(mi.UInt32(band)))
            np.testing.assert_array_equal(found.numpy()[0], np.array(band) + 1)
        strange = points.take(mi.UInt32([0, 1]))
        strange.key += 1
        with pytest.raises(PellucidError, match="2 of 2 points"):
            known.exitance(None, None, strange)
    assert picture.integrator.method is method


def test_many_workers_on_paper():
    """24 frames of 2 s after 3 s of preparation, 1 MB each; and 100 s of light of which 90 s are shared."""
    one = Run(seconds=3 + 48, first=5, pieces=24, sent=24_000_000)
    alone, all_at_once, many = (of_pieces(one, 0.004, workers, 100) for workers in (1, 24, 2400))
    assert (alone.preparation, alone.pieces, alone.seconds) == pytest.approx((3, 4800, 4803))
    assert (all_at_once.pieces, all_at_once.bottleneck) == (pytest.approx(200), "pieces")
    assert (many.pieces, many.scheduler, many.network) == pytest.approx((2, 9.6, 2.4))
    assert (many.seconds, many.bottleneck) == (pytest.approx(12.6), "scheduler")
    light, two = Run(100, 100, 1, 0), Run(55, 55, 1, 200_000_000)
    assert [of_light(light, two, 0.004, n).seconds for n in (1, 2, 10)] == pytest.approx([100, 55, 19])
    assert of_light(light, two, 0.004, 1000).bottleneck == "network"
