"""Tests run in the LLVM RGB variant unless they set another; it is active before test modules are imported."""

import os
import shutil
import signal

# The threads of a matrix product wait busily for the next one: two processes of tests on two cores have none to spare for that.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest

import pellucid  # noqa: F401  (points Dr.Jit at the LLVM of the wheel before mitsuba is imported)

import mitsuba as mi  # isort: skip

mi.set_variant("llvm_ad_rgb")


LONG = {"docs", "page", "viewer", "test_style.py"}
"""Tests of these folders and files take longest."""


def pytest_collection_modifyitems(items):
    """Begin with what takes longest, so that in the end no process is left alone with it."""
    items.sort(key=lambda item: LONG.isdisjoint(item.path.parts))


@pytest.fixture(autouse=True)
def variant():
    """Undo a variant that a test has set."""
    yield
    if mi.variant() != "llvm_ad_rgb":
        mi.set_variant("llvm_ad_rgb")


@pytest.fixture(autouse=True, scope="session")
def control_c():
    """Hear Ctrl-C: shells start what they run in the background with it ignored, and children inherit that."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


# ------------------------------------------------------------------ one browser without a window, for all tests

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
