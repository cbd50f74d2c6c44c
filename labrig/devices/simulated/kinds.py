"""The products that are simulated: an EPOS2 24/5, and any CiA 402 drive by its EDS file, which behaves as an EPOS4."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from labrig.devices.drives import objects as co
from labrig.devices.drives.model import Cia402Section
from labrig.devices.drives.objects import Place

_SOFTWARE, _HARDWARE = Place(0x2003, 1), Place(0x2003, 2)
_ENCODER_PULSES = Place(0x2210, 1)
_CONTINUOUS_CURRENT, _MAX_CURRENT = Place(0x6410, 1), Place(0x6410, 2)
_COUNTS_PER_PULSE = 4
_EPOS2_24_5, _SOFTWARE_TRIED = 0x6220, 0x2122


@dataclass(frozen=True)
class Behaviour:
    """How a product behaves.

    Parameters
    ----------
    switch_errors : mapping of int to int
        Bit of a limit switch that stops it -> error code.
    position_limit_error : int
        Error code of a passed software limit.
    disabling_errors : frozenset of int
        Errors that switch the power stage off at once; to all others the drive reacts as 0x605E says.
    reset_communication_first : frozenset of int
        Errors that stay until this NMT command.
    switch_mask : Place or None
        Object that says which limit switches stop the drive; None: both do.
    zero_is_no_limit : bool
        Whether software limits of zero both are none.
    fixed : mapping of Place to int
        What a drive has instead of the defaults of its EDS file, and keeps through every reset.
    """

    switch_errors: Mapping[int, int]
    position_limit_error: int
    disabling_errors: frozenset[int]
    reset_communication_first: frozenset[int]
    switch_mask: Place | None = None
    zero_is_no_limit: bool = False
    fixed: Mapping[Place, int] = field(default_factory=dict)


EPOS2 = Behaviour(
    switch_errors={0x0001: 0xFF06, 0x0002: 0xFF07},
    position_limit_error=0xFF09,
    # By maxon's firmware specification of the first EPOS generation (798675-03).
    disabling_errors=frozenset(
        {0x1000, 0x2310, 0x3210, 0x3220, 0x4210, 0x5113, 0x6100, 0x6320, 0x7320}
        | {0xFF01, 0xFF02, 0xFF03, 0xFF04, 0xFF0A, 0xFF0B}
    ),
    reset_communication_first=frozenset({0x8120, 0x81FD}),
    switch_mask=Place(0x2071, 4),
)

CIA402 = Behaviour(
    switch_errors={0x0001: 0x8A80, 0x0002: 0x8A81},
    position_limit_error=0x8A82,
    disabling_errors=frozenset({0x2310, 0x3210}),
    reset_communication_first=frozenset({0x8120, 0x8130, 0x81FD}),
    zero_is_no_limit=True,
)
_MODES = 0x21
"""0x6502: profile position, homing."""


def be_epos2(
    section: Cia402Section, hardware: int = _EPOS2_24_5, software: int = _SOFTWARE_TRIED
) -> Behaviour:
    """Return the behaviour of an EPOS2 of this hardware and software version."""
    fixed = {
        _ENCODER_PULSES: round(section.scale().counts_per_turn) // _COUNTS_PER_PULSE,
        _HARDWARE: hardware,
        _SOFTWARE: software,
        co.VENDOR_ID: 0xFB,
        co.PRODUCT_CODE: hardware << 16,
        co.REVISION: software << 16,
        co.SERIAL_NUMBER: 1000 + section.node_id,
    }
    if hardware == _EPOS2_24_5:
        fixed |= {_CONTINUOUS_CURRENT: 5000, _MAX_CURRENT: 10_000}
    return replace(EPOS2, fixed=fixed)


def be_cia402(section: Cia402Section) -> Behaviour:
    """Return the behaviour of a CiA 402 drive with the units and the encoder that its section states."""
    model = section.model()
    fixed = {
        co.DEVICE_TYPE: 0x00020192,
        co.VENDOR_ID: model.eds.vendor,
        co.PRODUCT_CODE: model.eds.product,
        co.REVISION: model.eds.revision or 0,
        co.SERIAL_NUMBER: 1000 + section.node_id,
        co.SUPPORTED_MODES: _MODES,
        **{stated.place: stated.raw for stated in model.stated if stated.raw is not None},
    }
    if not model.has(co.MAX_FOLLOWING_ERROR):
        fixed[co.MAX_FOLLOWING_ERROR] = 0xFFFFFFFF
    return replace(CIA402, fixed=fixed)
