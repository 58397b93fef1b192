"""Pictures and turns on a cluster, for the commands that have ``--cluster``."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import ClusterError, PellucidError
from ..jobs.frames import FrameFolder
from ..jobs.job import Request
from ..jobs.output import save_film, shows_denoised
from ..jobs.tiles import TileFolder, merge
from .interrupts import interruptible

if TYPE_CHECKING:
    from ..cluster.cluster import Cluster
    from .reporter import StageClock


def render_picture(address: str, request: Request, outputs: tuple[Path, ...], clock: StageClock) -> None:
    """Render a picture in tiles, which are kept until it is written."""
    from ..methods.denoising import can_denoise

    folder = TileFolder(outputs[0])
    try:
        _run(address, folder.left, lambda cluster: cluster.render_tiles(request, folder.there, folder.keep))
    except BaseException:
        folder.remove_if_empty()
        raise
    with clock.stage("writing"):
        film, layers = merge(folder.read())
        shown = layers if any(map(shows_denoised, outputs)) and layers is not None and can_denoise() else None
        save_film(film, outputs, shown)
        folder.remove()


def render_frames(address: str, request: Request, folder: FrameFolder, missing: list[int]) -> None:
    """Render the frames of a turn that are missing."""
    _run(
        address,
        folder.left,
        lambda cluster: cluster.render_frames(request, missing, len(folder.paths), folder.keep),
    )


def _run(address: str, left: Callable[[], str], work: Callable[[Cluster], object]) -> None:
    """Let a cluster work; whatever ends it is told with what is left.

    Raises
    ------
    PellucidError
        When the cluster, or the scene, does not allow it.
    """
    from ..cluster.cluster import Cluster

    with interruptible(left), Cluster(address) as cluster:
        try:
            work(cluster)
        except ClusterError as error:
            kept = left()
            raise PellucidError(f"{error} {kept[0].upper()}{kept[1:]}.") from None
