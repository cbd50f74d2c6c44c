"""The units of velocity and acceleration that a drive reports (0x60A9, 0x60AA), coded by CiA 303-2."""

from collections.abc import Mapping

VELOCITY_CODES = {0xB447: "rpm", 0xB403: "turns/s", 0xB503: "counts/s"}
ACCELERATION_CODES = {0xC003: "rpm/s"}
"""Numerator and denominator -> name of the unit in a rig file; 0xC0 is maxon's. Other units are not compared."""


def read_unit(value: int, codes: Mapping[int, str]) -> tuple[str, float] | None:
    """Return the unit in a value of 0x60A9 or 0x60AA, and its factor; None for an unknown unit."""
    unit = codes.get(value >> 8 & 0xFFFF)
    exponent = int.from_bytes(bytes([value >> 24 & 0xFF]), signed=True)
    return None if unit is None else (unit, 10.0**exponent)


def write_unit(unit: str, factor: float, codes: Mapping[int, str]) -> int | None:
    """Return the value of 0x60A9 or 0x60AA for a unit; None for a unit without a code."""
    found = next((code for code, name in codes.items() if name == unit), None)
    exponent = next((power for power in range(-9, 10) if abs(10.0**power / factor - 1) < 1e-9), None)
    if found is None or exponent is None:
        return None
    return (exponent & 0xFF) << 24 | found << 8
