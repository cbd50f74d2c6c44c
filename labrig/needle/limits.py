"""Limits on the parameters of a needle."""

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
        With the value, its limit and the reason.
    """
    lowest, highest = limits
    if lowest <= value <= highest:
        return
    limit = f"at most {highest:.4g} {unit}" if value > highest else f"at least {lowest:.4g} {unit}"
    raise InputError(
        f"{name} is {value:g} {unit}, and has to be {limit}: {why}",
        f"give a value from {lowest:.4g} to {highest:.4g} {unit}",
    )
