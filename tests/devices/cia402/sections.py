"""Sections of axes with CiA 402 drives, and such drives on a bus."""

from pathlib import Path

from labrig.devices.drives.generic import DRIVE, Cia402Axis
from tests.devices.cia402.eds_text import HOME, RATED_CURRENT, WINDOW, eds_text

_OF_MAXON = (0x3000, 0x3001, 0x30B0, 0x30B1, 0x30D1, 0x603F, 0x60A8, 0x60A9, 0x60AA)


def section_of(folder: Path, text: str | None = None, **changes: object) -> Cia402Axis:
    """Return the example section with an EDS file of its own in `folder`, and with changes."""
    (folder / "drive.eds").write_text(eds_text() if text is None else text, encoding="ascii")
    values = DRIVE.example(1).model_dump() | {"eds": "drive.eds"} | changes
    return Cia402Axis.model_validate(values, strict=False).placed_in(folder)


def other_make(folder: Path) -> Cia402Axis:
    """Return the section of a drive of another make: the profile's own objects, and none of maxon's."""
    device = {"VendorNumber": "0x2F", "ProductName": "a drive of another make", "ProductNumber": 7}
    return section_of(
        folder,
        eds_text(*RATED_CURRENT, *HOME, *WINDOW, without=_OF_MAXON, device=device),
        velocity_unit="counts/s",
        acceleration_unit="counts/s^2",
        quick_stop_option=2,
        home_here_method=35,
        referenced_bit=None,
        objects={"home_position": "0x607C:00"},
    )
