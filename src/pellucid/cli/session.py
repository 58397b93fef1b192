"""What every command that renders sets up first: variant, threads, progress; and how Mitsuba's errors are told."""

from __future__ import annotations

import traceback
from collections.abc import Iterator
from contextlib import contextmanager

from .. import _kernel_folder
from ..errors import PellucidError, first_cause, warn
from ..jobs.job import SessionOptions
from ..kernels.backend import FEWEST_THREADS, choose_variant
from ..progress import reporting_to
from .interrupts import interruptible
from .reporter import StageClock, clock_of


@contextmanager
def session(options: SessionOptions) -> Iterator[StageClock]:
    """Set Mitsuba up, report progress, and turn whatever Mitsuba raises into one line.

    Raises
    ------
    EnvironmentProblem
        When the variant cannot run here.
    PellucidError
        In place of every ``RuntimeError`` of Mitsuba, with the line that names the cause.
    """
    import drjit as dr
    import mitsuba as mi

    choose_variant(options.variant)
    mi.set_log_level(mi.LogLevel.Info if options.verbose else mi.LogLevel.Error)
    if options.threads is not None:
        dr.set_thread_count(max(options.threads, FEWEST_THREADS))
    dr.set_log_level(dr.LogLevel.Info if options.verbose else dr.LogLevel.Error)
    if _kernel_folder.OBSTACLE:
        warn(_kernel_folder.advice())
    clock = clock_of(options.quiet)
    try:
        with reporting_to(clock), dr.scoped_set_flag(dr.JitFlag.KernelHistory, True), interruptible():
            yield clock
    except PellucidError:
        if options.verbose:
            traceback.print_exc()
        raise
    except RuntimeError as error:
        if options.verbose:
            traceback.print_exc()
        raise PellucidError(first_cause(str(error))) from error
    except MemoryError as error:
        raise PellucidError("The memory is not enough: lower --resolution, --spp or --samples.") from error
    finally:
        clock.close()
