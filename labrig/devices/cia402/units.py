"""The units that a drive says it takes velocities and accelerations in (0x60A9, 0x60AA), coded as CiA 303-2 has it."""

from collections.abc import Mapping

VELOCITY_CODES = {0xB447: "rpm", 0xB403: "turns/s", 0xB503: "counts/s"}
ACCELERATION_CODES = {0xC003: "rpm/s"}
"""Numerator and denominator -> unit as a rig file names it; 0xC0 is maxon's. Others are not compared."""


def read_unit(value: int, codes: Mapping[int, str]) -> tuple[str, float] | None:
    """Return the unit that a value of 0x60A9 or 0x60AA names, and how many of it one is; None for an unknown one."""
    unit = codes.get(value >> 8 & 0xFFFF)
    exponent = int.from_bytes(bytes([value >> 24 & 0xFF]), signed=True)
    return None if unit is None else (unit, 10.0**exponent)


def write_unit(unit: str, factor: float, codes: Mapping[int, str]) -> int | None:
    """Return the value of 0x60A9 or 0x60AA for a unit; None for one that has no code."""
    found = next((code for code, name in codes.items() if name == unit), None)
    exponent = next((each for each in range(-9, 10) if abs(10.0**each / factor - 1) < 1e-9), None)
    if found is None or exponent is None:
        return None
    return (exponent & 0xFF) << 24 | found << 8
