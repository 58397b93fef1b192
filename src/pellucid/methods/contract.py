"""The contract of a method: what it prepares of a scene, and how it evaluates the exitance from that.

A method is a plain class, a dataclass of its parameters. One integrator (`integrator.TranslucentIntegrator`) makes a plug-in of any
of them; `pellucid.methods.METHODS` names them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar, Generic, Self, TypeVar, final

import drjit as dr
import mitsuba as mi

from ..kernels.sequences import ROUNDS
from ..light.irradiance import LANES
from ..light.transport import Limits
from ..scene.bodies import Body
from . import aovs
from .parameters import parameter, read
from .preparation import LitScene

LIGHT_RR_DEPTH = 2
"""Paths that measure irradiance play Russian roulette early: the profile averages over so many of them that its noise does
not show, and the time saved buys more paths."""

ENDLESS = 0xFFFFFFFF

State = TypeVar("State", bound=LitScene)


@dataclass
class Points:
    """Points of translucent surfaces at which the exitance is asked for, one a lane.

    Attributes
    ----------
    p : Point3f
        Positions [scene units].
    n : Normal3f
        Normals of the surface there.
    body : UInt32
        Numbers of their bodies, from 1 on; 0 for a lane that is no point.
    tolerance : Float
        1 where a point is seen directly; where another surface shows it, how many times larger its error may be.
    key : UInt32
        What the random numbers of a point come from. The same key at the same point gives the same result.
    stretch : Color3f, optional
        How many times wider the profile is there than that of the body's medium, by channel (`stretch.Stretch`).
    """

    p: mi.Point3f
    n: mi.Normal3f
    body: mi.UInt32
    tolerance: mi.Float
    key: mi.UInt32
    stretch: mi.Color3f | None = None

    def take(self, index: mi.UInt32) -> Points:
        """Gather some of the points."""
        return Points(*(None if v is None else dr.gather(type(v), v, index) for v in vars(self).values()))

    def stretch_on(self, body: Body, index: mi.UInt32) -> mi.Color3f | None:
        """Gather the stretch of some of the points, all on one body; None where that has one profile."""
        return dr.gather(mi.Color3f, self.stretch, index) if body.is_stretched else None


def key_of_positions(p: mi.Point3f, seed: int) -> mi.UInt32:
    """Make a key of each position, whatever its place in the array."""
    key = dr.opaque(mi.UInt32, seed & 0xFFFFFFFF)
    for x in (p.x, p.y, p.z):
        key = mi.sample_tea_32(key, dr.reinterpret_array(mi.UInt32, x + 0.0), ROUNDS)[0]  # -0 is 0
    return key


@dataclass
class Method(ABC, Generic[State]):
    """How the exitance of translucent bodies is prepared and evaluated; its fields are the parameters of the plug-in.

    The exitance at a point depends on the scene, the parameters, the prepared state and the point alone, bit for bit: not on what
    was asked before, nor on the other points, their order or their number.
    """

    name: ClassVar[str]
    """The plug-in is called ``pellucid_`` and this."""
    needs_normals: ClassVar[bool] = False
    """Whether `exitance` reads the normals of points."""
    uses_view: ClassVar[bool] = False
    """Whether `prepare_view` does anything."""
    is_random: ClassVar[bool] = False
    """Whether the exitance is an estimate by random numbers from the key of a point, which takes many points to average: they share none.
    Otherwise samples of a pixel share it where they agree in place and normal."""
    one_point_a_pixel: ClassVar[bool] = False
    """Whether samples of a pixel share it however large the pixel is, and what is not seen directly in any case."""
    stretches: ClassVar[bool] = False
    """Whether `exitance` knows of profiles that are wider at one point than at another, where dmfp is a texture."""
    is_reference: ClassVar[bool] = False
    """Whether it is there to measure others against: its pictures are never denoised."""

    @property
    def has_gradients(self) -> bool:
        """Whether pictures have gradients: a method whose do has ``derivatives`` of its sums (`surface_samples.LitSamplesMethod`)."""
        return False

    view_paths: ClassVar[int] = 1
    """Paths through each pixel of a camera that meet the points of a view, or as many as `paths_at_once` leaves of them."""
    paths_at_once: ClassVar[int] = LANES

    max_depth: int = parameter(6, at_least=0, endless=-1)
    rr_depth: int = parameter(5, at_least=1)
    hide_emitters: bool = parameter(False)
    irradiance_depth: int | None = parameter(None, at_least=2, endless=-1)
    aovs: str = parameter("")
    seed: int = parameter(0, at_least=0)

    def __post_init__(self) -> None:
        self.channels = aovs.parse(self.aovs)

    # ------------------------------------------------------------------ what a method defines

    @abstractmethod
    def prepare(self, scene: mi.Scene, opened: LitScene) -> State:
        """Prepare what does not depend on a view.

        Parameters
        ----------
        opened : LitScene
            The bodies of the scene, nothing prepared yet.
        """

    def prepare_view(self, scene: mi.Scene, state: State, view: Points | None) -> State:
        """Prepare what depends on a view.

        Parameters
        ----------
        view : Points, optional
            About the points that will be asked for: a few paths through each pixel of a camera meet them. None if there is no camera.
        """
        return state

    @abstractmethod
    def exitance(self, scene: mi.Scene, state: State, points: Points) -> mi.Color3f:
        """Evaluate the radiant exitance at points."""

    # ------------------------------------------------------------------ parameters

    @classmethod
    @final
    def from_properties(cls, properties: Any) -> Self:
        """Make a method from the properties of a plug-in, or from a dictionary."""
        return cls(**read(cls, properties))

    @final
    def parameters(self) -> dict[str, Any]:
        """Return the parameters that make another method like this one: for ``mi.load_dict({"type": ..., **parameters})``."""
        values = {f.name: getattr(self, f.name) for f in fields(self) if f.init}
        return {name: value for name, value in values.items() if value is not None}

    @final
    def with_parameters(self, **changed: Any) -> Self:
        """Make a method that differs in some parameters."""
        return replace(self, **changed)

    @property
    def limits(self) -> Limits:
        """When paths from the eye end."""
        return Limits(_depth(self.max_depth), self.rr_depth, self.hide_emitters)

    @property
    def light_limits(self) -> Limits:
        """When paths that measure irradiance end."""
        if self.irradiance_depth is not None:
            return Limits(_depth(self.irradiance_depth), LIGHT_RR_DEPTH)
        return Limits(max(_depth(self.max_depth), 2), LIGHT_RR_DEPTH)


def _depth(depth: int) -> int:
    """Write a depth as paths count it: -1 is no limit."""
    return ENDLESS if depth == -1 else depth


def shared_parameters(one: type[Method], other: type[Method]) -> set[str]:
    """Name the parameters that mean the same in two methods: those of a class that both derive from."""
    return {f.name for base in one.__mro__ if base in other.__mro__ and _is_method(base) for f in fields(base)}


def _is_method(cls: type) -> bool:
    return hasattr(cls, "__dataclass_fields__")
