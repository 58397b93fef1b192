"""Tests run in the LLVM RGB variant unless they set another; it is active before test modules are imported."""

import pytest

import pellucid  # noqa: F401  (points Dr.Jit at the LLVM of the wheel before mitsuba is imported)

import mitsuba as mi  # isort: skip

mi.set_variant("llvm_ad_rgb")


@pytest.fixture(autouse=True)
def variant():
    """Undo a variant that a test has set."""
    yield
    if mi.variant() != "llvm_ad_rgb":
        mi.set_variant("llvm_ad_rgb")
