"""How far the picture of the single pass is from that of its reference, where that is too large to be rendered.

Some pixels are chosen. The reference is estimated at all eye points that they and their neighbours show, twice and independently:
the mean product of how far a mode is from both is its own squared error, and what is random in the references cancels. Pixels are
then put together from eye points by the integrator itself, with its paths, its filter and the same random numbers.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, ClassVar, final

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation
from scipy.sparse import csr_array

from pellucid.errors import PellucidError
from pellucid.gather.gather import gather_all, lookup
from pellucid.gather.source import sample_source
from pellucid.methods.contract import Method, Points
from pellucid.methods.preparation import LitScene
from pellucid.methods.single_pass.integrator import SinglePass
from support.single_pass import Cuts, Picture, Seen, light_some

DRAWS, FEWEST = 1024, 64
"""Samples that are lit for an eye point in plain view, and at least for one seen by way of another surface, whose errors are larger."""

AROUND = np.ones((3, 3), bool)
"""Pixels that a pixel is filtered from; a Gaussian of half a pixel gives 99.4 % of its weight to these."""


@dataclass
class Windows:
    """Some pixels, the share of the picture that each stands for, and the eye points in them and around them by prototype."""

    pixel: NDArray[np.int64]
    share: NDArray[np.float64]
    index: list[NDArray[np.int64]]

    def take(self, seen: list[Seen]) -> list[Seen]:
        """Select the eye points."""
        return [s.take(index) for s, index in zip(seen, self.index, strict=True)]


@final
@dataclass
class Given(Method[LitScene]):
    """A method that knows the exitance at all points of a picture, in whatever order and bands they are asked for."""

    name: ClassVar[str] = "given"
    one_point_a_pixel: ClassVar[bool] = SinglePass.one_point_a_pixel
    paths_at_once: ClassVar[int] = SinglePass.paths_at_once

    known: Any = field(default=None, init=False)
    """Which points, sorted (`_names`)."""
    exitances: Any = field(default=None, init=False)

    def prepare(self, scene: mi.Scene, opened: LitScene) -> LitScene:
        """Prepare nothing."""
        return opened

    def exitance(self, scene: mi.Scene, state: LitScene, points: Points) -> mi.Color3f:
        """Give what is known."""
        asked = _names(points)
        number = np.minimum(np.searchsorted(self.known, asked), len(self.known) - 1)
        strange = int(np.count_nonzero(self.known[number] != asked))
        if strange:
            raise PellucidError(
                f"{strange} of {len(asked)} points are not those of the picture: its paths have changed."
            )
        return mi.Color3f(np.ascontiguousarray(self.exitances[number].T, np.float32))


def _names(points: Points) -> NDArray[np.uint64]:
    """Name each point by its key, which belongs to the path, and a part of its place, as keys alone may be equal by chance."""
    x = points.p.x.numpy().view(np.uint32)
    return points.key.numpy().astype(np.uint64) << np.uint64(32) | x.astype(np.uint64)


@contextmanager
def given(picture: Picture, values: list[NDArray]) -> Iterator[None]:
    """Let eye points have these exitances ``(n, 3)``, prototype by prototype, when the picture is rendered once more."""
    method = picture.integrator.method
    other = Given(max_depth=method.max_depth, rr_depth=method.rr_depth, hide_emitters=method.hide_emitters)
    exitances = np.zeros((len(picture.pixel), 3))
    for place, value in zip(picture.place, values, strict=True):
        exitances[place] = value
    names = _names(picture.points)
    order = np.argsort(names)
    other.known, other.exitances = names[order], exitances[order]
    picture.integrator.method = other
    try:
        yield
    finally:
        picture.integrator.method = method


def shown(picture: Picture) -> csr_array:
    """Tell which eye points each pixel shows: ``(pixels, eye points)``, counted over all prototypes, not zero where it does."""
    number = np.arange(len(picture.pixel))
    pixel = picture.pixel[np.concatenate(picture.place)]
    pixels = int(np.prod(picture.image.shape[:2]))
    return csr_array((np.ones(len(pixel)), (pixel, number)), shape=(pixels, len(number)))


def choose_windows(picture: Picture, wanted: int, rng: np.random.Generator) -> Windows:
    """Choose pixels at random: two of three where bodies are in plain view, which differ most, the others elsewhere."""
    shows = shown(picture)
    shape = picture.image.shape[:2]
    ends = np.cumsum([len(s) for s in picture.seen])
    direct = np.concatenate([s.eyes.tolerance.numpy() <= 1 for s in picture.seen])
    plain = binary_dilation((shows @ direct > 0).reshape(shape), AROUND).ravel()
    pixel, share, wide = [], [], np.zeros(shape, bool)
    for part, count in ((np.flatnonzero(plain), 2 * wanted // 3), (np.flatnonzero(~plain), wanted // 3)):
        chosen = rng.permutation(part)[:count]
        pixel.append(chosen)
        share.append(np.full(len(chosen), len(part) / len(plain) / max(len(chosen), 1)))
        wide.ravel()[chosen] = True
    inside = np.unique(shows[np.flatnonzero(binary_dilation(wide, AROUND))].indices)
    owner = np.searchsorted(ends, inside, side="right")
    index = [inside[owner == k] - (ends[k] - len(s)) for k, s in enumerate(picture.seen)]
    return Windows(np.concatenate(pixel), np.concatenate(share), index)


def pixels_of(picture: Picture, spp: int, windows: Windows, values: list[NDArray]) -> NDArray[np.float64]:
    """Render the chosen pixels, where the eye points of the windows have these exitances and all others none: ``(k, 3)``."""
    everywhere = [np.zeros((len(s), 3)) for s in picture.seen]
    for all_of, index, value in zip(everywhere, windows.index, values, strict=True):
        all_of[index] = value
    with given(picture, everywhere):
        image = np.array(picture.integrator.render(picture.scene, spp=spp), float)
    return image.reshape(-1, image.shape[-1])[windows.pixel, :3]


@dataclass
class Judge:
    """Two independent estimates of the reference: at eye points ``(n, 3)`` by prototype, and at pixels ``(k, 3)``."""

    picture: Picture
    spp: int
    windows: Windows
    references: list[list[NDArray]]
    pixels: list[NDArray]

    def of_picture(self, values: list[NDArray]) -> dict[str, float]:
        """Give the RMSE of the picture over its mean, and its standard error: all pixels count, as far as bodies show in them."""
        found = pixels_of(self.picture, self.spp, self.windows, values)
        first, second = (found - reference for reference in self.pixels)
        each = (first * second).mean(axis=1)
        weight, mean = self.windows.share, float(self.picture.image.mean())
        square = float(weight @ each)
        spread = float(np.sqrt(np.square(weight * (each - square)).sum()))
        rms = np.sqrt(max(square, 0.0))
        return {"picture": rms / mean, "picture_error": spread / (2 * max(rms, 1e-30)) / mean}

    def of_eye_points(self, values: list[NDArray], picked: list[NDArray]) -> dict[str, float]:
        """Give the RMSE of the exitance of some of the eye points over its mean, and its bias."""
        first, second = (_joined(reference, picked) for reference in self.references)
        found = np.concatenate(values)
        mean = float(first.mean() + second.mean()) / 2
        square = float(((found - first) * (found - second)).mean())
        return {"rmse": float(np.sqrt(max(square, 0.0))) / mean, "bias": float(found.mean()) / mean - 1}

    def plain(self) -> list[NDArray]:
        """Tell which eye points of the windows are in plain view, by prototype."""
        return [np.flatnonzero(s.eyes.tolerance.numpy() <= 1) for s in self.windows.take(self.picture.seen)]


def _joined(values: list[NDArray], picked: list[NDArray]) -> NDArray:
    return np.concatenate([value[index] for value, index in zip(values, picked, strict=True)])


def call_judge(picture: Picture, spp: int, wanted: int, seed: int = 0) -> Judge:
    """Choose pixels, and estimate the reference there."""
    windows = choose_windows(picture, wanted, np.random.default_rng(seed))
    seen = windows.take(picture.seen)
    references = [[reference_exitance(picture, s, number) for s in seen] for number in (1, 2)]
    pixels = [pixels_of(picture, spp, windows, reference) for reference in references]
    return Judge(picture, spp, windows, references, pixels)


# ------------------------------------------------------------------ the reference


def reference_exitance(picture: Picture, seen: Seen, seed: int) -> NDArray[np.float64]:
    """Estimate what the reference finds at a few eye points, by Lightcuts at a few of all samples: ``(n, 3)``."""
    if not len(seen):
        return np.zeros((0, 3))
    draws = draw_samples(seen, seed)
    # A sample that several eye points draw is lit once.
    keys, back = np.unique(draws.key, return_inverse=True)
    return draws.sums(light_keys(picture, seen, keys, Cuts(picture.integrator.method.max_error), seed)[back])


def light_keys(picture: Picture, seen: Seen, keys: NDArray, cuts: Cuts, seed: int) -> NDArray[np.float64]:
    """Find the light that enters at samples, which are numbered over all copies, by Lightcuts: ``(n, 3)``."""
    leaves = seen.body.samples.leaves
    return light_some(picture.scene, picture.state, seen.body, keys % leaves, keys // leaves, cuts, seed)[0]


@dataclass
class Draws:
    """Samples drawn for ``count`` eye points: the eye point of each draw, the sample, and the weight ``(m, 3)`` of its light."""

    count: int
    owner: NDArray[np.int64]
    key: NDArray[np.int64]
    weight: NDArray[np.float64]

    def sums(self, light: NDArray) -> NDArray[np.float64]:
        """Sum the light ``(m, 3)`` of the draws for each eye point: ``(n, 3)``."""
        return np.stack([np.bincount(self.owner, part, self.count) for part in (self.weight * light).T], axis=1)


def draw_samples(seen: Seen, seed: int, most: int = DRAWS) -> Draws:
    """Draw samples for eye points, in proportion to what each has of them if all are lit alike, evenly along the order of the tree.

    The expected sum is that over all samples.
    """
    samples, table, count = seen.body.samples, seen.body.table, len(seen)
    white = np.repeat(samples.area[:, None], 3, axis=1)
    source = sample_source(samples.p, white, table, mi.Float)
    end = dr.opaque(mi.UInt32, samples.count)
    total = mi.Color3f(*gather_all(samples.p, white, table, seen.eyes.p))
    dr.eval(total)
    draws = np.clip(most / np.square(seen.eyes.tolerance.numpy()), FEWEST, most).astype(np.uint32)
    first = np.cumsum(draws) - draws
    step = mi.Float(draws.astype(np.float32)) / dr.sum(total)
    u = mi.Float(np.random.default_rng(seed).random(count).astype(np.float32))
    number, packets = dr.zeros(mi.UInt32, int(draws.sum())), dr.zeros(mi.Float, 4 * int(draws.sum()))
    dr.eval(step, number, packets)
    dealt = _deal(
        source, seen.eyes.p, end, step, u, mi.UInt32(first.astype(np.uint32)), mi.UInt32(draws), number, packets
    )
    dr.eval(dealt, number, packets)
    weight = packets.numpy().reshape(-1, 4)[:, :3].astype(float)
    used = np.flatnonzero(weight.any(axis=1))
    owner = np.repeat(np.arange(count), draws)[used]
    leaf, copy = number.numpy()[used].astype(np.int64), seen.eyes.copy.numpy()[owner].astype(np.int64)
    return Draws(count, owner, copy * samples.leaves + leaf, weight[used] * samples.colour[leaf])


def _part(source, k, p) -> mi.Color3f:
    """Evaluate what a sample gives under an irradiance of 1."""
    place, area = dr.gather(mi.Array4f, source.records, 2 * k), dr.gather(mi.Array4f, source.records, 2 * k + 1)
    r2 = dr.squared_norm(mi.Point3f(place[0], place[1], place[2]) - p)
    return mi.Color3f(*lookup(source, r2, mi.Bool(True))) * area[0]


@dr.syntax
def _deal(source, p, end, step, u, first, draws, number, packets) -> mi.UInt32:
    """Deal draws to samples, one to every ``1 / step`` of what they give: which samples, and what their light is multiplied with."""
    k, dealt, passed = mi.UInt32(0), mi.UInt32(0), mi.Float(u)
    while dr.hint(k < end, label="pellucid reference draws"):
        part = _part(source, k, p)
        share = dr.sum(part) * step
        passed += share
        here = mi.UInt32(passed)
        if (here > 0) & (dealt < draws):
            part *= mi.Float(here) / share
            dr.scatter(number, k, first + dealt)
            dr.scatter(packets, mi.Vector4f(part.x, part.y, part.z, 0), first + dealt)
        passed -= mi.Float(here)
        dealt += here
        k += 1
    return dealt
