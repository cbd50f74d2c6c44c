"""Limits on the parameters of a needle, with a hint if the unit was probably mistaken."""

import math

from labrig.errors import InputError


def require_within(name: str, value: float, limits: tuple[float, float], why: str, unit: str = "mm") -> None:
    """Refuse a value outside its limits.

    Parameters
    ----------
    name : str
        Of the value, as the message states it.
    value : float
        In `unit`.
    limits : (float, float)
        Lowest and highest allowed value.
    why : str
        What happens beyond the limit.

    Raises
    ------
    InputError
        With the value, its limit, the reason, and the unit that was probably meant.
    """
    lowest, highest = limits
    if lowest <= value <= highest:
        return
    limit = f"at most {highest:.4g} {unit}" if value > highest else f"at least {lowest:.4g} {unit}"
    raise InputError(
        f"{name} is {value:g} {unit}, and has to be {limit}: {why}", _unit_hint(value, lowest, highest, unit)
    )


def _unit_hint(value: float, lowest: float, highest: float, unit: str) -> str:
    if unit == "mm" and math.isfinite(value):
        if lowest <= value / 1000 <= highest:
            return f"lengths are in mm: {value:g} µm is {value / 1000:g} mm"
        if lowest <= value * 1000 <= highest:
            return f"lengths are in mm: {value:g} m is {value * 1000:g} mm"
    return f"give a value from {lowest:.4g} to {highest:.4g} {unit}"
