"""Mistaken units: a body so small or so large against its mean free path that a factor of 1000 must be at fault."""

from __future__ import annotations

FEWEST, MOST = 5.0, 3e4
"""Mean free paths across a body: below, hardly anything scatters in it; above, no sample count that is usual resolves it."""
FACTOR = 1000


def unit_mistake(name: str, size: float, mfp: float, scale: float = 1.0) -> str | None:
    """Say whether a body's size suggests that its units were mistaken.

    Parameters
    ----------
    name : str
        The body, for the message.
    size : float
        Its longest side [mm].
    mfp : float
        Its shortest mean free path [mm].
    scale : float
        Millimetres per scene unit, as they are now.

    Returns
    -------
    str or None
        One line that names the size, the mean free path and the factor; None for a size that is plausible.

    Examples
    --------
    >>> unit_mistake("teapot", 150.0, 0.33) is None
    True
    """
    across = f"'{name}' is {size:.3g} mm across and its mean free path is {mfp:.3g} mm"
    if size < FEWEST * mfp:
        return (
            f"{across}: too small for light to become diffuse in it. If its lengths are metres, a factor of {FACTOR} is "
            f"missing: set scale to {FACTOR * scale:g} mm a unit, now {scale:g} (of a bare mesh: --size {FACTOR * size:.3g})."
        )
    if size > MOST * mfp:
        return (
            f"{across}: so large that light seems not to spread at all. If its lengths were millimetres already, a factor "
            f"of {FACTOR} is too much: set scale to {scale / FACTOR:g} mm a unit, now {scale:g} "
            f"(of a bare mesh: --size {size / FACTOR:.3g})."
        )
    return None
