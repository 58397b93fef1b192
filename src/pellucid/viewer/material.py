"""The controls of a material: presets, coefficients by channel, reflectance and mean free path, and the size."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..model.materials import PRESETS
from ..model.medium import Medium
from ..realtime.source import FrameSource
from .controls import Gui, rounded, when_changed
from .loop import RenderLoop

CUSTOM, NOTHING = "as set below", "nothing"
COEFFICIENTS, COLOUR = "coefficients", "reflectance"
LARGEST_COEFFICIENT = (1000.0,) * 3
MOST_REFLECTANCE = (0.999,) * 3


def blend(one: Medium, other: Medium, share: float) -> Medium:
    """Interpolate the coefficients of two media."""
    mixed = [
        (1 - share) * np.asarray(getattr(one, name)) + share * np.asarray(getattr(other, name))
        for name in ("sigma_s_prime", "sigma_a", "g", "eta")
    ]
    return Medium(mixed[0], mixed[1], float(mixed[2]), float(mixed[3]), profile=one.profile)


class MaterialControls:
    """The folder of the material: every field shows the same medium, whichever of them it was set by."""

    def __init__(self, gui: Gui, loop: RenderLoop):
        self.loop = loop
        self.media = [body.medium for body in loop.source.bodies]
        names = [body.name for body in loop.source.bodies]
        self.numbers = {f"{name} ({k + 1})" if names.count(name) > 1 else name: k for k, name in enumerate(names)}
        medium = self.media[0]
        with gui.add_folder("Material"):
            self.body = gui.add_dropdown("Object", tuple(self.numbers), visible=len(names) > 1)
            self.preset = gui.add_dropdown("Preset", (*PRESETS, CUSTOM), initial_value=self._preset_of(medium))
            self.other = gui.add_dropdown("Blend with", (NOTHING, *PRESETS), initial_value=NOTHING)
            self.share = gui.add_slider("Share of it", 0.0, 1.0, 0.01, 0.5, visible=False)
            self.way = gui.add_button_group("Set by", (COEFFICIENTS, COLOUR))
            self._coefficients(gui, medium)
        self.base = medium
        self._show_way(COEFFICIENTS)

    def _coefficients(self, gui: Gui, medium: Medium) -> None:
        """Lay out the numbers, red, green and blue."""
        zero = (0.0,) * 3
        self.sigma_s_prime = gui.add_vector3(
            "σs′ [1/mm]",
            rounded(medium.sigma_s_prime),
            min=zero,
            max=LARGEST_COEFFICIENT,
            step=0.01,
            hint="Reduced scattering coefficient: red, green, blue",
        )
        self.sigma_a = gui.add_vector3(
            "σa [1/mm]",
            rounded(medium.sigma_a),
            min=zero,
            max=LARGEST_COEFFICIENT,
            step=0.0001,
            hint="Absorption coefficient: red, green, blue",
        )
        self.reflectance = gui.add_vector3(
            "Reflectance",
            zero,
            min=zero,
            max=MOST_REFLECTANCE,
            step=0.001,
            hint="Share of the entering light that comes out again: red, green, blue",
        )
        self.dmfp = gui.add_vector3(
            "Mean free path [mm]",
            (1.0,) * 3,
            min=(0.001,) * 3,
            max=(9999.0,) * 3,
            step=0.01,
            hint="Diffuse mean free path 1/σtr, over which light is blurred: red, green, blue",
        )
        self.eta = gui.add_slider("η", 1.0, 2.5, 0.01, float(np.clip(medium.eta, 1, 2.5)), hint="Index of refraction")
        self.g = gui.add_slider("g", -0.95, 0.95, 0.01, float(np.clip(medium.g, -0.95, 0.95)), hint="Mean cosine")
        when_changed(self.body, self._choose)
        when_changed(self.preset, self._from_preset)
        when_changed(self.other, self._apply)
        when_changed(self.share, self._apply)
        for control in (self.sigma_s_prime, self.sigma_a, self.eta, self.g):
            when_changed(control, self._from_coefficients)
        for control in (self.reflectance, self.dmfp):
            when_changed(control, self._from_colour)

        @self.way.on_click
        async def _(event: Any) -> None:
            self._show_way(self.way.value)

    @staticmethod
    def _preset_of(medium: Medium) -> str:
        """Name the preset that a medium is."""
        presets = ((name, Medium.from_preset(name, profile=medium.profile)) for name in PRESETS)
        return next((name for name, preset in presets if preset == medium), CUSTOM)

    def _show_way(self, way: str) -> None:
        """Show the fields of one of the two descriptions."""
        self.sigma_s_prime.visible = self.sigma_a.visible = way == COEFFICIENTS
        self.reflectance.visible = self.dmfp.visible = way == COLOUR
        self._show(self.base)

    def _choose(self) -> None:
        """Show the medium of another body."""
        self.base = self.media[self.numbers[self.body.value]]
        self.preset.value, self.other.value = self._preset_of(self.base), NOTHING
        self._show(self.base)

    def _from_preset(self) -> None:
        if self.preset.value != CUSTOM:
            self.base = Medium.from_preset(self.preset.value, profile=self.base.profile)
            self._apply()

    def _from_coefficients(self) -> None:
        self._try(
            lambda: Medium(
                self.sigma_s_prime.value,
                self.sigma_a.value,
                self.g.value,
                self.eta.value,
                profile=self.base.profile,
            )
        )

    def _from_colour(self) -> None:
        self._try(
            lambda: Medium.from_reflectance(
                self.reflectance.value, self.dmfp.value, self.eta.value, self.g.value, self.base.profile
            )
        )

    def _try(self, make: Any) -> None:
        """Use the medium that the fields describe; if there is none, say so where edits are carried out."""

        def refuse(source: FrameSource) -> None:
            make()

        try:
            self.base = make()
        except ValueError:
            self.loop.edit("bad medium", refuse)
            return
        self.preset.value = self._preset_of(self.base)
        self._apply()

    def _apply(self) -> None:
        """Give the medium to the body."""
        self.share.visible = self.other.value != NOTHING
        medium = self.base
        if self.other.value != NOTHING:
            medium = blend(medium, Medium.from_preset(self.other.value), self.share.value)
        k = self.numbers[self.body.value]
        self.media[k] = medium
        self._show(self.base)
        self.loop.edit(("medium", k), lambda source: source.set_medium(k, medium))

    def _show(self, medium: Medium) -> None:
        """Write a medium into all fields."""
        self.sigma_s_prime.value, self.sigma_a.value = rounded(medium.sigma_s_prime), rounded(medium.sigma_a)
        self.reflectance.value = rounded(np.minimum(medium.total_diffuse_reflectance, MOST_REFLECTANCE), 3)
        self.dmfp.value = rounded(medium.dmfp, 3)
        self.eta.value, self.g.value = float(medium.eta), float(medium.g)


class SizeControl:
    """The size of the bodies in the real world, as a number and as a slider of octaves."""

    OCTAVES = 5.0

    def __init__(self, gui: Gui, loop: RenderLoop):
        self.loop = loop
        self.first = max(body.size_mm for body in loop.source.bodies)
        with gui.add_folder("Object"):
            self.size = gui.add_number(
                "Size [mm]",
                rounded([self.first])[0],
                min=1e-3,
                max=1e6,
                step=0.5,
                hint="Largest extent; the smaller the object, the more light passes through it",
            )
            self.scale = gui.add_slider("Size × 2ⁿ, n", -self.OCTAVES, self.OCTAVES, 0.05, 0.0)
        when_changed(self.size, lambda: self._set(self.size.value))
        when_changed(self.scale, lambda: self._set(self.first * 2**self.scale.value))

    def _set(self, millimetres: float) -> None:
        self.size.value = rounded([millimetres])[0]
        self.scale.value = float(np.clip(np.log2(millimetres / self.first), -self.OCTAVES, self.OCTAVES))
        self.loop.edit("size", lambda source: source.set_size(millimetres))
