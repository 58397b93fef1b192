"""Memory that is kept for the next array, and goes back to the system at the end."""

import resource
import sys

import numpy as np
import pytest

from pellucid.kernels.memory import memory_at_hand


def faults():
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt


def touch():
    np.ones(1 << 24).sum()  # 128 MB


@pytest.mark.skipif(sys.platform != "linux", reason="glibc only")
def test_memory_is_kept_while_it_is_at_hand_and_then_given_back():
    touch()
    with memory_at_hand():
        touch()
        before = faults()
        for _ in range(4):
            touch()
        kept = faults() - before
    before = faults()
    for _ in range(4):
        touch()
    assert kept < 0.2 * (faults() - before)


def test_errors_pass(monkeypatch):
    with pytest.raises(KeyError), memory_at_hand():
        raise KeyError
    monkeypatch.setattr(sys, "platform", "elsewhere")
    with memory_at_hand():
        touch()
