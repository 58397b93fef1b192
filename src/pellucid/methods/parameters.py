"""The parameters of a method: fields of a dataclass that say what they may be, read from the properties of a plug-in."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import field, fields
from typing import Any

from ..errors import PellucidError, did_you_mean


def parameter(
    default: Any,
    meaning: str = "",
    at_least: float | None = None,
    above: float | None = None,
    at_most: float | None = None,
    endless: int | None = None,
    choices: Sequence[str] = (),
) -> Any:
    """Declare a field of a method as a parameter of its plug-in.

    Parameters
    ----------
    default
        Its type is that of the parameter; None stands for a whole number that is not given.
    meaning : str
        What the number is, with its unit, for messages: "a solid angle [sr]".
    at_least, above, at_most : float, optional
        Bounds of a number.
    endless : int, optional
        A whole number below the bound that stands for no limit at all.
    choices : sequence of str
        What a text may be.
    """
    limits = {"at_least": at_least, "above": above, "at_most": at_most, "endless": endless, "choices": choices}
    return field(default=default, metadata={"meaning": meaning, **limits})


def read(method: Any, properties: Any) -> dict[str, Any]:
    """Read and check the parameters of a method that are given, by name.

    Raises
    ------
    PellucidError
        With the parameter, what it may be, and what was found; and for one that the method does not have.
    """
    known = [f.name for f in fields(method) if f.init]
    for name in properties.keys():  # noqa: SIM118
        if name not in known:
            raise PellucidError(
                f"{name} is no parameter of pellucid_{method.name}{did_you_mean(name, known)}: it has {', '.join(known)}."
            )
    given = {name: properties[name] for name in known if name in properties}
    return {f.name: _checked(f.name, given[f.name], f.default, f.metadata) for f in fields(method) if f.name in given}


def _checked(name: str, value: Any, default: Any, limits: Mapping[str, Any]) -> Any:
    """Check one value against the type of its default and its limits."""
    if isinstance(default, bool):
        if not isinstance(value, bool):
            raise PellucidError(f"{name} is true or false; found {value!r}.")
        return value
    if isinstance(default, str):
        return _text(name, value, limits)
    return _number(name, value, default, limits)


def _text(name: str, value: Any, limits: Mapping[str, Any]) -> str:
    """Check a text."""
    choices = limits.get("choices", ())
    if not isinstance(value, str) or (choices and value not in choices):
        hint = did_you_mean(value, choices) if isinstance(value, str) else ""
        known = f"one of {', '.join(choices)}" if choices else "a text"
        raise PellucidError(f"{name} is {known}; found '{value}'{hint}.")
    return value


def _number(name: str, value: Any, default: Any, limits: Mapping[str, Any]) -> Any:
    """Check a number: a whole one, unless the default is a float."""
    whole = not isinstance(default, float)
    number = isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
    if number and whole and value == limits["endless"]:
        return value
    lowest, above, highest = limits["at_least"], limits["above"], limits["at_most"]
    fits = number and (lowest is None or value >= lowest) and (above is None or value > above)
    if fits and (highest is None or value <= highest) and (not whole or int(value) == value):
        return int(value) if whole else float(value)
    kind = limits["meaning"] or ("a whole number" if whole else "a number")
    bounds = [f"at least {lowest:g}"] if lowest is not None else []
    bounds += [f"above {above:g}"] if above is not None else []
    bounds += [f"at most {highest:g}"] if highest is not None else []
    bounds += [f"or {limits['endless']} for no limit"] if limits["endless"] is not None else []
    raise PellucidError(f"{name} is {', '.join([kind, *bounds])}; found {value!r}.")
