"""A viewer, and a page of it."""

import pytest

from worlds.fake_source import FakeSource
from worlds.served import Served, open_page, wait_for


@pytest.fixture(scope="module")
def served():
    pytest.importorskip("viser", reason="viser is not installed")
    served = Served(FakeSource(), reason="It has two bodies.")
    yield served
    served.stop()


@pytest.fixture(scope="module")
def page(browser, served):
    """One page for many tests, for a page takes seconds to open."""
    page = open_page(browser, served, 900, 500)
    yield page
    page.close()
    wait_for(lambda: not served.viewer.pages)
