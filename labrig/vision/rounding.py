"""Rounding for messages: a value that misses a limit never reads as the limit itself."""

import math


def round_down(value: float, decimals: int) -> str:
    """Return a value that is too small, or an upper limit, rounded down, as text."""
    step = 10.0**decimals
    return f"{math.floor(value * step) / step:.{decimals}f}"


def round_up(value: float, decimals: int) -> str:
    """Return a value that is too large, rounded up, as text."""
    step = 10.0**decimals
    return f"{math.ceil(value * step) / step:.{decimals}f}"
