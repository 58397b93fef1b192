"""Shared fixtures: every test runs in the LLVM RGB variant unless it sets another one itself."""

import pytest

import pellucid  # noqa: F401  (points Dr.Jit at the wheel's LLVM before mitsuba is imported)


@pytest.fixture(scope="session", autouse=True)
def variant():
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    return mi.variant()
