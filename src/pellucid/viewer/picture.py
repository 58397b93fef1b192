"""The controls of the picture: method, samples, exposure and highlight."""

from __future__ import annotations

from typing import Any

from .controls import Gui, when_changed
from .loop import RenderLoop

METHODS = {
    "plain: texture space": "texture_space",
    "hybrid: texture space and shadow map": "hybrid",
    "baseline: image space": "image_space",
}
SAMPLES = ("49", "100", "256", "400", "900", "1600", "2500", "4900", "10000", "14400")


class PictureControls:
    """The folders of method and picture."""

    def __init__(self, gui: Gui, loop: RenderLoop):
        self.loop = loop
        settings = loop.source.settings
        names = {value: name for name, value in METHODS.items()}
        with gui.add_folder("Method"):
            self._field(
                "method", gui.add_dropdown("Method", tuple(METHODS), initial_value=names[settings.method]), METHODS.get
            )
            options = sorted({*SAMPLES, str(settings.samples)}, key=int)
            self._field("samples", gui.add_dropdown("Samples N", options, initial_value=str(settings.samples)), int)
            hint = "Every fourth pixel of every fourth row while something moves, every pixel when all is still"
            self._field("interpolated", gui.add_checkbox("Coarse in motion", settings.interpolated, hint=hint), bool)
            hint = "When all is still, also the light that comes by way of other surfaces"
            self._field("gi", gui.add_checkbox("Indirect light", settings.gi, hint=hint), bool)
            self.points = gui.add_checkbox("Show samples", False, hint="Bright: seen from here; dark: behind")
            when_changed(self.points, lambda: loop.edit("points", lambda source: None))
        with gui.add_folder("Picture"):
            exposure = gui.add_slider("Exposure [stops]", -6.0, 6.0, 0.1, float(settings.exposure))
            self._field("exposure", exposure, float)
            self._field("specular", gui.add_slider("Highlight", 0.0, 4.0, 0.05, float(settings.specular)), float)
            denoised = gui.add_checkbox("Without noise at rest", bool(settings.denoised))
            self._field("denoised", denoised, bool)
            shininess = gui.add_slider("Its sharpness", 2.0, 300.0, 1.0, float(settings.shininess))
            self._field("shininess", shininess, float)

    def _field(self, name: str, control: Any, read: Any) -> None:
        """Let a control set a field of the settings."""

        def change(source: Any) -> None:
            setattr(source.settings, name, read(control.value))

        when_changed(control, lambda: self.loop.edit(("setting", name), change))
