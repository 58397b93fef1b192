"""The controls of the lights: colour, brightness, place, and a handle in the picture to drag."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..realtime.source import FrameSource, Light
from ..realtime.space import Space, Vector
from .controls import Gui, Vector3, shown, when_changed
from .guard import FARTHEST
from .loop import RenderLoop

STOPS = 6.0  # the range of a brightness slider, up and down
HANDLE_REACH = 0.65  # distance from the middle at which the handle of a far light is shown, in radii of the bodies


class Handle:
    """The model of a light that is dragged in its place: near the bodies, in the direction of the light.

    A lamp is often many times farther away than the picture shows. The handle stands on the line from the middle of the
    bodies to the lamp, ``reach`` times closer; dragging it moves the lamp ``reach`` times as far.
    """

    def __init__(self, space: Space, light: Light):
        self.space = space
        offset = self._offset(light)
        self.reach = max(1.0, float(np.linalg.norm(offset)) / HANDLE_REACH)

    def _offset(self, light: Light) -> Vector:
        """Find the light as seen from the middle of the bodies [radii]; one that is infinitely far away, at 1."""
        if light.position is not None:
            return self.space.to_page(light.position)
        assert light.direction is not None
        return -np.asarray(light.direction, float)

    def place(self, light: Light) -> Vector:
        """Find where the handle of a light stands on the page."""
        return self._offset(light) / self.reach

    def changes(self, light: Light, place: Vector) -> dict[str, Any]:
        """Translate a new place of the handle: a lamp moves, and one that has a direction keeps facing the bodies."""
        towards = -place / max(float(np.linalg.norm(place)), 1e-9)
        changes: dict[str, Any] = {}
        if light.position is not None:
            changes["position"] = self.space.to_scene(place * self.reach)
        if light.direction is not None:
            changes["direction"] = towards
        return changes


class LightControls:
    """The folder of the lights and the handle of the one that is chosen; environments have a folder of their own."""

    def __init__(self, server: Any, loop: RenderLoop, space: Space):
        self.loop, self.space, self.gui = loop, space, server.gui
        self.lights = list(loop.source.lights)
        self.brightest = [light.intensity for light in self.lights]
        lamps = [k for k, light in enumerate(self.lights) if light.position is not None or light.direction is not None]
        skies = [k for k, light in enumerate(self.lights) if k not in lamps]
        self.names = {self._name(k): k for k in lamps}
        with server.gui.add_folder("Light"):
            if lamps:
                self._lamp_controls(server, lamps[0])
            else:
                server.gui.add_markdown("The scene has no lamp: its environment lights it.")
        for k in skies:
            with server.gui.add_folder(
                "Environment" if len(skies) == 1 else f"Environment {self._name(k)}", expand_by_default=False
            ):
                self._shade_controls(server.gui, lambda k=k: k)

    def _name(self, k: int) -> str:
        """Name a light so that no two names are equal."""
        light = self.lights[k]
        own = f": {light.name}" if light.name not in ("", "emitter") else ""
        return f"{k + 1}, {light.kind}{own}"

    @property
    def chosen(self) -> int:
        """The number of the light that the controls belong to."""
        return self.names[self.which.value]

    # ------------------------------------------------------------------ controls

    def _lamp_controls(self, server: Any, first: int) -> None:
        """Lay out the controls of the lamps."""
        gui: Gui = server.gui
        low, high = (tuple(self.space.to_scene([end * FARTHEST] * 3).tolist()) for end in (-1, 1))
        self.which = gui.add_dropdown("Lamp", tuple(self.names), visible=len(self.names) > 1)
        self.colour, self.brightness = self._shade_controls(gui, lambda: self.chosen)
        self.position = gui.add_vector3(
            "Position", (0.0, 0.0, 0.0), min=low, max=high, step=0.1, hint="In units of the scene"
        )
        self.direction = gui.add_vector3("Shines along", (0.0, 0.0, -1.0), min=(-1e3,) * 3, max=(1e3,) * 3, step=0.01)
        self.visible = gui.add_checkbox("Show handle", True, hint="Drag it to move the lamp")
        when_changed(self.which, lambda: self._choose(self.chosen))
        when_changed(self.position, lambda: self._move(position=np.array(self.position.value)))
        when_changed(self.direction, lambda: self._move(direction=np.array(self.direction.value)))
        self.gizmo = server.scene.add_transform_controls(
            "/lamp", scale=0.35, disable_rotations=True, depth_test=False, line_width=3.0
        )
        self.bulb = server.scene.add_icosphere("/lamp/bulb", radius=0.03, color=(255, 225, 120), cast_shadow=False)

        @self.gizmo.on_update
        async def _(event: Any) -> None:
            self._drag(np.array(self.gizmo.position, float))

        @self.visible.on_update
        async def _(event: Any) -> None:
            self.gizmo.visible = self.visible.value

        self._choose(first)

    def _shade_controls(self, gui: Gui, chosen: Any) -> tuple[Any, Any]:
        """Lay out colour and brightness of a light."""
        k = chosen() if not self.names or chosen() not in self.names.values() else next(iter(self.names.values()))
        colour = gui.add_rgb("Colour", shown(self.lights[k].colour))
        brightness = gui.add_slider("Power [stops]", -STOPS, STOPS, 0.1, 0.0)

        def tint() -> None:
            self._set(chosen(), colour=np.array(colour.value, float) / 255)

        def shine() -> None:
            self._set(chosen(), intensity=self.brightest[chosen()] * 2.0**brightness.value)

        when_changed(colour, tint)
        when_changed(brightness, shine)
        return colour, brightness

    # ------------------------------------------------------------------ what they do

    def _set(self, k: int, **changes: Any) -> None:
        """Change a light, and read back what it has become."""

        def change(source: FrameSource) -> None:
            source.set_light(k, **changes)
            self.lights[k] = source.lights[k]

        self.loop.edit(("light", k, *changes), change)

    def _move(self, **changes: Any) -> None:
        """Move the lamp to where the numbers say, and its handle with it."""
        light = self.lights[self.chosen]
        vars_after = {**vars(light), **changes}
        self.gizmo.position = tuple(self.handle.place(Light(**vars_after)))
        self._set(self.chosen, **changes)

    def _drag(self, place: Vector) -> None:
        """Move the lamp to where its handle is, and the numbers with it."""
        changes = self.handle.changes(self.lights[self.chosen], place)
        self._show(changes.get("position"), changes.get("direction"))
        self._set(self.chosen, **changes)

    def _choose(self, k: int) -> None:
        """Show the state of a lamp."""
        light = self.lights[k]
        self.handle = Handle(self.space, light)
        self.gizmo.position = tuple(self.handle.place(light))
        self.bulb.color = shown(light.colour)
        self.colour.value = shown(light.colour)
        self.brightness.value = float(np.clip(np.log2(max(light.intensity, 1e-9) / self.brightest[k]), -STOPS, STOPS))
        self.position.visible, self.direction.visible = light.position is not None, light.direction is not None
        self._show(light.position, light.direction)

    def _show(self, position: Any, direction: Any) -> None:
        """Write place and direction into their fields."""
        fields: tuple[tuple[Vector3, Any], ...] = ((self.position, position), (self.direction, direction))
        for field, value in fields:
            if value is not None:
                field.value = tuple(np.round(np.asarray(value, float), 3).tolist())
