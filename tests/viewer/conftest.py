"""A browser without a window, a viewer, and a page of it."""

import shutil

import pytest

from worlds.fake_source import FakeSource
from worlds.served import Served, open_page, wait_for

FLAGS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]


@pytest.fixture(scope="session")
def browser():
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    program = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if program is None:
        pytest.skip("no browser is installed: apt-get install chromium")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=program, args=FLAGS)
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def served():
    pytest.importorskip("viser", reason="viser is not installed")
    served = Served(FakeSource())
    yield served
    served.stop()


@pytest.fixture(scope="module")
def page(browser, served):
    """One page for many tests, for a page takes seconds to open."""
    page = open_page(browser, served, 900, 500)
    yield page
    page.close()
    wait_for(lambda: not served.viewer.pages)
