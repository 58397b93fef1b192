"""Rendering on the workers of a cluster: what is sent, what comes back, and what happens when something is lost."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import CancelledError
from contextlib import closing, contextmanager, suppress
from dataclasses import replace
from itertools import cycle
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ..errors import ClusterError, EnvironmentProblem, install, warn
from ..jobs.frames import FrameFolder
from ..jobs.job import Request
from ..jobs.output import film_array
from ..jobs.tiles import Picture, Tile, merge
from ..kernels.backend import choose_variant
from ..progress import chunks
from .news import Listener, News, Watch
from .versions import UnfitWorker, refuse_others, versions
from .work import Work

try:
    from dask import config
    from dask.system import CPU_COUNT
    from distributed import Client, Future, KilledWorker, LocalCluster

    from . import worker
    from .parts import LOOK, Asking, Parts, with_light
except ModuleNotFoundError:
    raise EnvironmentProblem(f"A cluster needs distributed: {install('cluster')}.") from None

TILE_SIDE = 384
"""About how many rows and columns a tile has: its border is a small part of it, and hundreds of tiles make a large picture."""

FEWEST_IN_PART = 100
"""Samples that a part has at least: along the edges of parts they lie unevenly."""

SHARED_PATHS = 1 << 23
"""Light paths from which on workers share them; fewer are traced sooner by every worker for itself."""

PARTS_A_WORKER = 4

NEWS, NEWS_OF_ALL = 0.5, 200
"""Seconds between what one worker tells of its piece, and how many such news the scheduler gets in a second from all of them at most."""

PATIENCE = 30.0
"""Seconds that a scheduler may take to answer, and workers to come."""


class Cluster:
    """The workers of one scheduler.

    Parameters
    ----------
    address : str
        ``tcp://HOST:PORT`` or ``tls://HOST:PORT`` of a scheduler of Dask; ``local`` or ``local:N`` starts N workers on this machine, which
        end with it.

    Raises
    ------
    ClusterError
        When no scheduler answers, when it has no workers, or when one of them has other versions than this machine.
    """

    def __init__(self, address: str = "local"):
        for name in ("distributed", "distributed.client", "distributed.scheduler", "distributed.nanny"):
            logging.getLogger(name).setLevel(logging.CRITICAL)  # what is lost is told in one line, by us
        if mi.variant() is None:
            choose_variant()
        self.address = address
        self.threads: int | None = None
        self._local: LocalCluster | None = None
        self._told: set[str] = set()
        self._loading: dict[str, Future] = {}
        """Scenes that workers load: kept, so that none of them stops."""
        if address.startswith("tls:") and not config.get("distributed.comm.tls.ca-file"):
            raise ClusterError(
                f"'{address}' needs certificates: name them in distributed.comm.tls of Dask's configuration."
            )
        try:
            if address.partition(":")[0] == "local":
                self._start(int(address.partition(":")[2] or max(2, CPU_COUNT // 4)))
            self._client = Client(self._local or address, timeout=PATIENCE, set_as_default=False)
        except (OSError, TimeoutError) as error:
            raise ClusterError(
                f"No scheduler answers at '{address}' ({error}): start one, or check the address."
            ) from None
        self._topic = f"pellucid-{self._client.id}"
        try:
            self._check()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Cluster:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave the scheduler; workers of ours end."""
        self._client.close(timeout=5)
        if self._local is not None:
            self._local.close(timeout=10)

    def _start(self, count: int) -> None:
        """Start workers here, which share the cores."""
        self.threads = max(1, CPU_COUNT // count)
        self._local = LocalCluster(
            n_workers=count,
            threads_per_worker=1,
            host="127.0.0.1",
            dashboard_address=None,
            silence_logs=logging.CRITICAL,
            preload=["pellucid.cluster.unheard"],
        )

    def _check(self) -> None:
        """Wait for a worker, and compare the versions of all."""
        try:
            self._client.wait_for_workers(1, timeout=PATIENCE)
        except TimeoutError:
            raise ClusterError(
                f"The scheduler at '{self.address}' has no workers: start some with 'dask worker'."
            ) from None
        self._versions = versions()
        refuse_others(self._versions, self._client.run(versions, on_error="return"))

    @property
    def workers(self) -> list[str]:
        """Addresses of the workers that are there."""
        return list(self._client.nthreads())

    # ------------------------------------------------------------------ for programs

    def render(self, source: str | Path, *, denoise: bool = False, **options: Any) -> NDArray[np.float32]:
        """Render a picture.

        Parameters
        ----------
        source : str or Path
            A scene file of Mitsuba, a mesh, or the name of a built-in scene; what it names beside itself travels with it.
        denoise : bool
            Take the noise out.
        options
            As of ``pellucid render``, with underscores: ``method``, ``spp``, ``resolution``, ``sensor``, ``material``, ... and
            ``sample_parts``, into how many parts the samples are divided, each of which stays on one worker, where they are too many for
            the memory of one.

        Returns
        -------
        (h, w, 3) float32
            Radiance, the same bits as those of one process; with ``sample_parts`` the same for the same number of parts.

        Raises
        ------
        PellucidError
            For what ``pellucid render`` refuses, and when the cluster is lost.
        """
        request = Request.of(source, denoise=denoise, **options)
        tiles: list[Tile] = []
        self.render_tiles(request, lambda _: set(), tiles.append)
        film, layers = merge(tiles)
        return film_array(film) if layers is None else layers.denoised

    def turntable(self, source: str | Path, folder: str | Path, frames: int = 36, **options: Any) -> list[Path]:
        """Render the frames of a turn to a folder, those that are missing in it; parameters as of `render`.

        Returns
        -------
        list of Path
            The pictures.
        """
        request = Request.of(source, **options)
        there = FrameFolder(Path(folder), request.settings(), frames)
        missing = there.missing()
        if missing:
            self.render_frames(request, missing, frames, there.keep)
        return there.paths

    # ------------------------------------------------------------------ pieces

    def render_tiles(
        self, request: Request, there: Callable[[Picture], set[int]], keep: Callable[[Tile], None]
    ) -> Picture:
        """Render the tiles of a picture.

        Parameters
        ----------
        there : callable
            Is told what the tiles belong to, and says which of them it has already.
        keep : callable
            Is given each tile, in the order in which they come back.
        """
        with self._working(request) as (key, survey):
            columns, rows = (-(-survey.film[size] // TILE_SIDE) for size in ("crop_width", "crop_height"))
            picture = Picture(request.settings(), survey.film, survey.extra, columns * rows)
            missing = sorted({*range(1, picture.count + 1)} - there(picture))
            light = self._light(key, survey, request.sample_parts) if missing else None
            pieces = [(number, picture.count) for number in missing]
            tasks, parts = with_light(light, worker.tile, worker.points_of_tile, key, pieces)
            self._collect("tiles", tasks, lambda _, tile: keep(replace(tile, picture=picture)), parts=parts)
        return picture

    def render_frames(
        self, request: Request, missing: list[int], frames: int, keep: Callable[[int, bytes], None]
    ) -> None:
        """Render some of the frames of a turn; ``keep`` is given the number of each and its PNG, in the order in which they come back."""
        with self._working(request) as (key, survey):
            light = self._light(key, survey, request.sample_parts)
            pieces = [(number, frames) for number in missing]
            tasks, parts = with_light(light, worker.frame, worker.points_of_frame, key, pieces)
            self._collect("frames", tasks, keep, parts=parts)

    @contextmanager
    def _working(self, request: Request) -> Iterator[tuple[str, worker.Survey]]:
        """Send a request to every worker, those that come later included, and let all of them load its scene."""
        session = request.session
        here = replace(session, variant=session.variant or mi.variant(), threads=session.threads or self.threads)
        request = replace(request, session=here)
        work = Work.of(request, self._versions)
        setup = worker.Setup(work)
        self._told.clear()
        with self._losses():
            self._client.register_plugin(setup)
            self._client.subscribe_topic(self._topic, lambda event: self._inbox.put(News.of(event)))
            try:
                yield work.key, self._survey(work.key)
            finally:
                if self._client.status == "running":
                    self._client.unsubscribe_topic(self._topic)
                    self._client.unregister_worker_plugin(setup.name)

    def _survey(self, key: str) -> worker.Survey:
        """Let every worker load the scene, and ask the first one that is done."""
        found: list[worker.Survey] = []
        at = {address: address for address in self.workers}
        tasks = dict.fromkeys(at, (worker.survey, key))
        self._loading = self._collect("scene", tasks, lambda _, survey: found.append(survey), 1, at)
        return found[0]

    def _light(self, key: str, survey: worker.Survey, sample_parts: int) -> Any:
        """Let the workers share the light paths, if there are many: the samples, and the parts of their light, where they lie.

        Every worker makes the same tree of them; or each keeps parts of the samples, if that is asked for, and trees of these.
        """
        from ..light.irradiance import at_once

        if sample_parts:
            in_each = sum(survey.samples) // sample_parts
            if in_each < FEWEST_IN_PART:
                raise ClusterError(
                    f"sample_parts: {in_each} samples in each of {sample_parts} parts lie unevenly along its edges; ask for at most "
                    f"{max(sum(survey.samples) // FEWEST_IN_PART, 1)} parts."
                )
            parts = Parts(key, sample_parts, self.workers)
            self._collect("irradiance", parts.lighting, lambda *_: None, at=parts.at, parts=parts)
            return parts
        workers = len(self.workers)
        in_all = sum(count * paths for count, paths in zip(survey.samples, survey.paths, strict=True))
        if in_all < SHARED_PATHS or workers < 2:
            return None
        samples = self._collect("samples", {"all": (worker.spread, key)}, None)["all"]
        tasks = {}
        for body, (count, paths) in enumerate(zip(survey.samples, survey.paths, strict=True)):
            groups = in_all / (workers * PARTS_A_WORKER) / (paths * at_once(paths))
            first = 0
            for size in chunks(count, max(1, round(groups)) * at_once(paths)):
                tasks[body, first] = (worker.light, key, samples, body, range(first, first + size), paths)
                first += size
        # Left to itself, Dask lets the one that has the samples light them all.
        futures = self._collect("irradiance", tasks, None, at=dict(zip(tasks, cycle(self.workers), strict=False)))
        return samples, [
            [futures[place] for place in futures if place[0] == body] for body in range(len(survey.samples))
        ]

    # ------------------------------------------------------------------ tasks

    def _collect(
        self,
        stage: str,
        tasks: Mapping[Any, tuple[Any, ...]],
        keep: Callable[[Any, Any], None] | None,
        enough: int | None = None,
        at: Mapping[Any, str] | None = None,
        parts: Parts | None = None,
    ) -> dict[Any, Future]:
        """Send tasks and wait for them, or for ``enough`` of them; give their results to ``keep``, or leave them where they are.

        ``at`` names the worker for each; others may do it, if that one is lost: of what needs ``parts`` of the samples, who gets those.
        Whatever ends this early, Ctrl-C for one, takes back what is not done.
        """
        self._inbox: SimpleQueue[News | Future] = SimpleQueue()
        listener = Listener(self._topic, stage, max(NEWS, len(self.workers) / NEWS_OF_ALL))

        def send(function: Any, *arguments: Any, **where: Any) -> Future:
            known = (each.send(send) if isinstance(each, Asking) else each for each in arguments)
            return self._client.submit(function, *known, listener=listener, pure=False, **where)

        def submit(place: Any) -> Future:
            where: dict[str, Any] = {"workers": [at[place]], "allow_other_workers": parts is None} if at else {}
            future = send(*tasks[place], **where)
            future.add_done_callback(self._inbox.put)
            return future

        def begin_again(key: str) -> None:
            place = places.pop(key)
            futures[place] = again = submit(place)
            places[str(again.key)] = place
            watch.begin_again(key, str(again.key))

        futures = {place: submit(place) for place in tasks}
        places = {str(future.key): place for place, future in futures.items()}
        wanted = len(tasks) if enough is None else enough
        try:
            with closing(Watch(stage, places, wanted)) as watch:
                while wanted:
                    came = self._hear(parts)
                    if came is None:
                        for key in [*places]:
                            begin_again(key)
                    elif isinstance(came, News):
                        watch.hear(came)
                    elif (key := str(came.key)) in places:
                        if self._is_refused(came):
                            begin_again(key)
                            continue
                        if keep is not None:
                            keep(places[key], self._value(came))
                        elif came.status != "finished":
                            came.result()
                        del places[key]
                        watch.complete(key)
                        wanted -= 1
                        if parts is not None:
                            parts.lost = 0
        except BaseException:
            if self._client.status == "running":
                self._client.cancel(list(futures.values()), force=True)
            raise
        return futures

    def _hear(self, parts: Parts | None) -> News | Future | None:
        """Wait for what comes next; None where parts of the samples have got other workers."""
        if parts is None:
            return self._inbox.get()
        while not parts.moved(lambda: self.workers):
            with suppress(Empty):
                return self._inbox.get(timeout=LOOK)
        return None

    def _is_refused(self, future: Future) -> bool:
        """Tell whether a task has met a worker of other versions, which has come later; that one is sent away, and said so once."""
        error = future.exception() if future.status == "error" else None
        if not isinstance(error, UnfitWorker):
            return False
        self._warn(f"{error} It is sent away.")
        self._client.retire_workers([error.address])
        return True

    def _value(self, future: Future) -> Any:
        """Fetch a result, and repeat its warnings, each once."""
        told = future.result()
        self._warn(*told.warnings)
        return told.value

    def _warn(self, *texts: str) -> None:
        """Warn, once of the same."""
        for text in texts:
            if text not in self._told:
                self._told.add(text)
                warn(text)

    @contextmanager
    def _losses(self) -> Iterator[None]:
        """Say in one line what was lost."""
        try:
            yield
        except KilledWorker as lost:
            limit = lost.last_worker.memory_limit
            memory = f" of {limit / 1e9:.3g} GB" if limit else ""
            raise ClusterError(
                f"{lost.allowed_failures + 1} workers were lost at one and the same piece, the last one {lost.last_worker.address}. Most "
                f"often their memory{memory} is not enough: lower --samples, --spp or --resolution, or give them more."
            ) from None
        except (CancelledError, OSError) as error:
            if isinstance(error, ClusterError) or (
                self._client.status == "running" and not isinstance(error, CancelledError)
            ):
                raise
            raise ClusterError(f"The scheduler at '{self.address}' is lost; what has come back is kept.") from None
