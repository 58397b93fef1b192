"""What runs on a worker: the scene is opened once, and then rendered piece by piece."""

from __future__ import annotations

import tempfile
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, is_dataclass, replace
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
    from numpy.typing import NDArray

    from ..light.irradiance import PathLight
    from ..methods.preparation import LitScene
    from ..scene.samples.surface import SurfaceSamples

    Measured = tuple["Told", list[list["Told"]]]
    """The samples of all bodies, and the parts of the light on each of them."""

    Answered = dict[str, Any]
    """Where samples stay in parts: the ``points`` that a piece asks for, and the ``sums`` that each of the parts has there."""

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
    parts: dict[int, LitScene] = field(default_factory=dict)
    """Parts of the samples that are kept here, by their numbers."""


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
    """Add up the bytes of a result, arrays in objects, tuples and lists included: Dask plans by them what lies where."""
    if isinstance(value, list | tuple):
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

    method, parts = opened.integrator.method, opened.job.request.sample_parts
    found = Survey(describe_film(opened.job.sensor.film()), opened.integrator.aov_names(), [], [])
    if isinstance(method, SpreadSamplesMethod):
        bodies = open_scene(opened.job.scene)
        found.samples = method.count_samples(bodies, max(parts, 1))
        found.paths = method.paths_by_body(bodies, found.samples)
        if parts:
            method.check_parts()
    elif parts:
        raise PellucidError(
            f"--sample-parts (sample_parts): parts of the samples add up for two_pass and exact, not for {method.name}: leave it out."
        )
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
def light_part(opened: Opened, number: int) -> int:
    """Spread and light a part of the samples, and keep it here; tell how many bytes its samples and trees have."""
    return sum(_size([lit.samples, lit.irradiance, lit.state]) for lit in _part(opened, number).bodies if lit.state)


@_task
def points_of_tile(opened: Opened, number: int, count: int) -> NDArray[np.float32]:
    """List the points at which a tile asks for the exitance (`methods.elsewhere.Asked`)."""
    _prepare(opened, None, number, count)
    return _asked(opened, number, count)


@_task
def points_of_frame(opened: Opened, number: int, frames: int) -> NDArray[np.float32]:
    """List the points at which a frame asks for the exitance."""
    _prepare(opened, None)
    _place(opened, number, frames)
    return _asked(opened, 1, 1)


@_task
def exitance(opened: Opened, number: int, points: Told) -> NDArray[np.float32]:
    """Sum the exitance at points over a part of the samples, ``(n, 3)``, which is lit first if another worker has kept it and is lost."""
    from ..kernels.memory import rows
    from ..methods.elsewhere import points_of

    _warn_again(points)
    lit = _part(opened, number)
    if len(points.value) == 0:
        return np.zeros((0, 3), np.float32)
    return rows(opened.integrator.method.exitance(opened.job.scene, lit, points_of(points.value)))


@_task
def tile(opened: Opened, light: Measured | Answered | None, number: int, count: int) -> Tile:
    """Render a tile of the picture."""
    _prepare(opened, light, number, count)
    return opened.job.render_tile(opened.integrator, number, count)


@_task
def frame(opened: Opened, light: Measured | Answered | None, number: int, frames: int) -> bytes:
    """Render a frame of a turn, as a PNG."""
    _prepare(opened, light)
    _place(opened, number, frames)
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


def _part(opened: Opened, number: int) -> LitScene:
    """Give a part of the samples, after lighting it if it is not here."""
    if number not in opened.parts:
        bodies = _bodies(opened)
        fresh = replace(bodies, bodies=[replace(lit) for lit in bodies.bodies])
        method, count = opened.integrator.method, opened.job.request.sample_parts
        opened.parts[number] = method.prepare_part(opened.job.scene, fresh, number, count)
    return opened.parts[number]


def _place(opened: Opened, number: int, frames: int) -> None:
    """Move the camera to where it is in a frame."""
    assert opened.orbit is not None
    opened.orbit.place(opened.job.sensor, 2 * np.pi * number / frames)


def _asked(opened: Opened, number: int, count: int) -> NDArray[np.float32]:
    """Trace a tile for the sake of its points."""
    from ..methods.elsewhere import Asked
    from ..methods.tiles import make_tile

    asked = opened.integrator.prepared.elsewhere = Asked()
    request, sensor = opened.job.request, opened.job.sensor
    film = make_tile(sensor.film(), number, count)
    opened.integrator.render_tile(opened.job.scene, sensor, film, request.seed, request.spp)
    return asked.points()


def _prepare(opened: Opened, light: Measured | Answered | None, number: int = 1, count: int = 1) -> None:
    """Let the method prepare the scene, once, before a tile: from light that was measured in parts, if it was.

    Where samples stay in parts, each tile is told the exitance at its points.
    """
    from ..methods.elsewhere import Known

    in_parts = opened.job.request.sample_parts > 0
    if opened.orbit is None:
        resume: Callable[[Any, LitScene], LitScene] | None = _without_samples if in_parts else None
        if isinstance(light, tuple):
            resume = _resumed(opened, light)
        if not in_parts:
            opened.bodies = None
        opened.job.prepare(opened.integrator, number, count, resume)
        opened.orbit = Orbit.around(opened.job.sensor, opened.integrator.prepared.bodies)
    if isinstance(light, dict):
        sums = light["sums"]
        _warn_again(*sums)
        total = sum((told.value for told in sums[1:]), sums[0].value)  # in the order of parts
        opened.integrator.prepared.elsewhere = Known(light["points"].value, total)


def _warn_again(*results: Told) -> None:
    """Pass on what was warned of where results come from."""
    for text in (text for told in results for text in told.warnings):
        warn(text)


def _without_samples(scene: Any, bodies: LitScene) -> LitScene:
    """Prepare nothing more."""
    return bodies


def _resumed(opened: Opened, measured: Measured) -> Callable[[Any, LitScene], LitScene]:
    """Say how to prepare from light that was measured in parts."""
    from ..light.irradiance import PathLight

    samples, parts = measured
    _warn_again(samples, *(part for body in parts for part in body))
    light = [PathLight.join([part.value for part in body]) for body in parts]
    return lambda scene, bodies: opened.integrator.method.resume(scene, bodies, samples.value, light)


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
