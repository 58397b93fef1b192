"""What runs on a worker: the scene is opened once, and then rendered piece by piece."""

from __future__ import annotations

import tempfile
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, is_dataclass
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from dask.sizeof import sizeof
from dask.system import CPU_COUNT
from distributed import WorkerPlugin, get_worker

from ..errors import EnvironmentProblem, PellucidError, PellucidWarning, first_cause, warn
from ..jobs.job import Job
from ..jobs.orbit import Orbit
from ..jobs.output import save_film
from ..jobs.tiles import Tile
from ..kernels import free_memory
from ..progress import reporting_to
from .news import Listener, Teller
from .versions import UnfitWorker, difference, versions
from .work import Work

if TYPE_CHECKING:
    from ..light.irradiance import PathLight
    from ..methods.preparation import LitScene
    from ..scene.samples.surface import SurfaceSamples

    Measured = tuple["Told", list[list["Told"]]]
    """The samples of all bodies, and the parts of the light on each of them."""

_lock = threading.RLock()
"""One piece at a time: Dr.Jit has one pool of threads, and materials act in one role."""

OUT_OF_MEMORY = "out of memory"
"""What Dr.Jit says when it gets none."""

WATCHED = 0.95
"""The part of its limit of memory at which Dask ends a worker."""

_works: dict[str, Work] = {}
_opened: dict[str, Opened] = {}


class Setup(WorkerPlugin):
    """Brings the work to a worker: to those that are there, and to those that come later."""

    idempotent = True

    def __init__(self, work: Work):
        self.work = work
        self.name = f"pellucid-{work.key}"

    def setup(self, worker: Any) -> None:
        """Keep it, and let the worker go on to its limit of memory: Dask would have it wait for others to take its results."""
        _works[self.work.key] = self.work
        worker.memory_manager.memory_pause_fraction = False

    def teardown(self, worker: Any) -> None:
        """Forget it, and what was made of it."""
        _works.pop(self.work.key, None)
        _opened.pop(self.work.key, None)


@dataclass
class Opened:
    """A scene that is loaded from files in a folder; ``orbit`` is the way of the camera, once the method has prepared the scene."""

    job: Job
    integrator: Any
    folder: tempfile.TemporaryDirectory[str]
    orbit: Orbit | None = None
    bodies: LitScene | None = None
    """The bodies, where some of their light is measured here."""


@dataclass
class Survey:
    """What a worker has found in a scene.

    Attributes
    ----------
    film, extra : dict, list of str
        As of `jobs.tiles.Picture`.
    samples, paths : list of int
        How many samples each body gets, and how many light paths each of them; none where light cannot be measured in parts.
    """

    film: dict[str, Any]
    extra: list[str]
    samples: list[int]
    paths: list[int]


@dataclass
class Told:
    """A result, and the warnings that came with it."""

    value: Any
    warnings: list[str]


@sizeof.register(Told)
def _size(value: Any) -> int:
    """Add up the bytes of a result, arrays in objects and lists included: Dask plans by them what lies where."""
    if isinstance(value, list):
        return sum(map(_size, value))
    return sum(map(_size, vars(value).values())) if is_dataclass(value) else int(sizeof(value))


def _task(function: Callable[..., Any]) -> Callable[..., Told]:
    """Make a task of a function of opened work: one at a time, with the errors and warnings of this package only, telling how far it is."""

    @wraps(function)
    def run(key: str, *arguments: Any, listener: Listener) -> Told:
        worker = get_worker()
        teller = Teller(listener, str(worker.get_current_task()), worker.log_event)
        with _lock, warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            with _plain_errors(), reporting_to(teller):
                value = function(_open(key), *arguments)
        return Told(value, [str(w.message) for w in caught if issubclass(w.category, PellucidWarning)])

    return run


@_task
def survey(opened: Opened) -> Survey:
    """Load the scene, and tell what others need to know of it."""
    from ..methods.preparation import open_scene
    from ..methods.surface_samples import SpreadSamplesMethod
    from ..methods.tiles import describe_film

    method = opened.integrator.method
    found = Survey(describe_film(opened.job.sensor.film()), opened.integrator.aov_names(), [], [])
    if isinstance(method, SpreadSamplesMethod):
        bodies = open_scene(opened.job.scene)
        found.samples = method.count_samples(bodies)
        found.paths = method.paths_by_body(bodies, found.samples)
    return found


@_task
def spread(opened: Opened) -> list[SurfaceSamples]:
    """Spread the samples of all bodies."""
    bodies = _bodies(opened)
    opened.integrator.method.spread_all(bodies)
    return [lit.samples for lit in bodies.bodies]


@_task
def light(opened: Opened, samples: Told, number: int, part: range, paths: int) -> PathLight:
    """Light some samples of one body, by so many paths each."""
    bodies = _bodies(opened)
    for lit, spread_here in zip(bodies.bodies, samples.value, strict=True):
        lit.samples = spread_here
    return opened.integrator.method.light_part(opened.job.scene, bodies, number, part, paths)


@_task
def tile(opened: Opened, measured: Measured | None, number: int, count: int) -> Tile:
    """Render a tile of the picture."""
    _prepare(opened, measured, number, count)
    return opened.job.render_tile(opened.integrator, number, count)


@_task
def frame(opened: Opened, measured: Measured | None, number: int, frames: int) -> bytes:
    """Render a frame of a turn, as a PNG."""
    _prepare(opened, measured)
    assert opened.orbit is not None
    opened.orbit.place(opened.job.sensor, 2 * np.pi * number / frames)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "frame.png"
        layers = opened.job.render(opened.integrator, [path])
        save_film(opened.job.sensor.film(), [path], layers)
        return path.read_bytes()


def _bodies(opened: Opened) -> LitScene:
    """Find the bodies of a scene, once."""
    from ..methods.preparation import open_scene

    if opened.bodies is None:
        opened.bodies = open_scene(opened.job.scene)
    return opened.bodies


def _prepare(opened: Opened, measured: Measured | None, number: int = 1, count: int = 1) -> None:
    """Let the method prepare the scene, once, before a tile: from light that was measured in parts, if it was."""
    from ..light.irradiance import PathLight

    if opened.orbit is not None:
        return
    resume = None
    if measured is not None:
        samples, parts = measured
        for told in (samples, *(part for body in parts for part in body)):
            for text in told.warnings:
                warn(text)
        light = [PathLight.join([part.value for part in body]) for body in parts]

        def resume(scene: Any, bodies: LitScene) -> LitScene:
            return opened.integrator.method.resume(scene, bodies, samples.value, light)

    opened.bodies = None
    opened.job.prepare(opened.integrator, number, count, resume)
    opened.orbit = Orbit.around(opened.job.sensor, opened.integrator.prepared.bodies)


@contextmanager
def _plain_errors() -> Iterator[None]:
    """Turn what Mitsuba raises into one line, as the command line does."""
    try:
        yield
    except EnvironmentProblem as error:
        raise EnvironmentProblem(f"The worker {_name()}: {error}") from None
    except (RuntimeError, MemoryError) as error:
        if isinstance(error, MemoryError) or OUT_OF_MEMORY in str(error):
            raise EnvironmentProblem(_out_of_memory()) from None
        raise PellucidError(first_cause(str(error))) from None


def _out_of_memory() -> str:
    """Say how much memory this worker holds, and of how much."""
    worker = get_worker()
    held, limit = worker.monitor.get_process_memory(), worker.memory_manager.memory_limit
    most = f" of the {limit / 1e9:.3g} GB that it may hold" if limit else ""
    return (
        f"The worker {_name()} is out of memory with {held / 1e9:.3g} GB{most}: lower --resolution, --spp or --samples, "
        "or give it more."
    )


def _name() -> str:
    """Name this worker."""
    worker = get_worker()
    return f"{worker.name} ({worker.address})" if str(worker.name) != worker.address else str(worker.address)


def _open(key: str) -> Opened:
    """Give what is opened, after loading it if this is the first time."""
    if key in _opened:
        return _opened[key]
    import drjit as dr

    from ..kernels.backend import FEWEST_THREADS, choose_variant

    work = _works[key]
    told = difference(work.versions, versions())
    if told:
        raise UnfitWorker(_name(), told, get_worker().address)
    session = work.request.session
    choose_variant(session.variant)
    threads = session.threads or CPU_COUNT
    dr.set_thread_count(max(threads, FEWEST_THREADS))  # files need a second one
    limit = get_worker().memory_manager.memory_limit
    free_memory.watched_limit = int(WATCHED * limit) if limit else None
    _opened.clear()  # one scene at a time, for the sake of memory
    folder = tempfile.TemporaryDirectory(prefix="pellucid-", dir=get_worker().local_directory)
    job = work.request_in(Path(folder.name)).load()
    dr.set_thread_count(threads)
    _opened[key] = Opened(job, job.integrator(), folder)
    return _opened[key]
