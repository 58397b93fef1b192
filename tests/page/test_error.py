"""The page beside the engine and `exact` on three models of four materials, two of them with the curved profile as well.

``pytest -m slow tests/page``: three minutes.
"""

import pytest

WORSE = {"texture_space": 0.002, "hybrid": 0.001}


@pytest.mark.slow
def test_pixels_of_three_models_and_four_materials(browser):
    """At 128 x 128, where the rasteriser sees what a ray through the middle of the pixel sees."""
    import page_error

    rows = page_error.pixels(page_error.FULL | {"sides": (128,)}, browser)
    assert len(rows) == 36
    wrong = [
        row
        for row in rows
        if row["same"]["page, exact"] > row["same"]["engine, exact"] + WORSE[row["method"]]
        or abs(row["light"] - 1) > 0.003
    ]
    assert wrong == []
