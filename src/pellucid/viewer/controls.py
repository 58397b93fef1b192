"""What all parts of the panel share."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

Gui = Any
"""``viser.GuiApi``: what controls are added to."""

Vector3 = Any
"""``viser.GuiVector3Handle``: three numbers."""


def when_changed(control: Any, act: Callable[[], None]) -> None:
    """Act when a user changes a control, but not when the program does."""

    @control.on_update
    async def _(event: Any) -> None:
        if event.client is not None:
            act()


def shown(colour: ArrayLike) -> tuple[int, int, int]:
    """Write a colour in [0, 1] with 8 bits."""
    red, green, blue = (round(255 * float(np.clip(value, 0, 1))) for value in np.asarray(colour, float))
    return red, green, blue


def rounded(values: ArrayLike, digits: int = 4) -> tuple[float, ...]:
    """Round numbers for a field, to digits that count; infinity becomes a number that can be typed."""
    finite = np.clip(np.nan_to_num(np.asarray(values, float), posinf=9999.0), -9999.0, 9999.0)
    return tuple(float(f"{value:.{digits}g}") for value in finite)
