"""The section of an axis with an EPOS2, the settings of its drive, and their fingerprint (0x1020)."""

import zlib
from collections.abc import Iterator, Mapping
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from labrig.devices import canopen_objects as co
from labrig.devices.axis_description import AxisDescription, HomingDescription
from labrig.devices.can_description import HeartbeatDescription, NodeId
from labrig.devices.canopen_objects import Entry
from labrig.devices.epos2 import objects as od
from labrig.devices.homing import HOMING_HERE
from labrig.devices.units import AxisScale
from labrig.protocol.model import Conflict

MAX_RPM = 25_000
_SWITCH_BITS = {"negative": 1, "positive": 2}

HOMING_DIRECTIONS = {
    1: -1,  # negative limit switch and index
    2: +1,  # positive limit switch and index
    17: -1,  # negative limit switch
    18: +1,  # positive limit switch
    -1: +1,  # current threshold, positive speed, and index
    -2: -1,  # current threshold, negative speed, and index
    -3: +1,  # current threshold, positive speed
    -4: -1,  # current threshold, negative speed
    HOMING_HERE: 0,
}
"""Homing method -> sign of the motor's speed during its search, as maxon defines it: -1 and -3 go in the POSITIVE
direction until the current threshold. `canopen` has the opposite sign, which would drive an axis the wrong way."""

BY_CURRENT = frozenset({-1, -2, -3, -4})
"""Methods that run into a mechanical stop."""


_DIGITAL_INPUTS = ("negative-limit", "positive-limit", "home", "position-marker", "drive-enable")
_GENERAL_INPUTS = {f"general-{letter}": bit for bit, letter in enumerate("HGFEDCBA", start=8)}
ANALOG_INPUTS = {f"analog-{entry.subindex}": entry for entry in od.ANALOG_INPUTS}
"""Name of an analog input -> its object."""


class Epos2Homing(HomingDescription):
    """Homing of an axis."""

    method: Literal[35, -1, -2, -3, -4, 1, 2, 17, 18] = Field(
        35,
        description="maxon's homing method. 35: home is the present position, on confirmation. By current, to the stop "
        "in the motor's positive direction: -1, -3; in its negative direction: -2, -4; -1 and -2 then go to the index. "
        "1, 2, 17, 18: to a limit switch.",
    )
    current_threshold_ma: Annotated[int, Field(ge=1, le=65535)] = Field(
        500, description="Motor current that counts as having reached the stop [mA]."
    )


class Epos2Axis(AxisDescription):
    """One axis with an EPOS2 of maxon. Lengths are mm, or rad where `unit` is rad."""

    homing_directions = HOMING_DIRECTIONS
    needed = ("encoder_pulses_per_turn", *AxisDescription.needed)
    where_to_find: ClassVar[Mapping[str, str]] = {
        "encoder_pulses_per_turn": "lines of the encoder on the motor: data sheet, or 0x2210:01 in EPOS Studio",
        **AxisDescription.where_to_find,
    }
    count_unit = "quadcounts"
    digital_inputs: ClassVar[Mapping[str, int]] = {
        **{name: bit for bit, name in enumerate(_DIGITAL_INPUTS)},
        **_GENERAL_INPUTS,
    }
    """Name of a digital input -> its bit in 0x2071:01, which is its number in 0x2070 (maxon's EposCmd: A is 15)."""

    driver: Literal["epos2"] = Field("epos2", description="Kind of drive.")
    node_id: NodeId = Field(description="CANopen node id of the drive, as set by its DIP switches.")
    encoder_pulses_per_turn: Annotated[int, Field(ge=16, le=2_500_000)] | None = Field(
        description="Encoder lines per turn of the motor; a quadcount is a quarter of a line. null: unknown [-]."
    )
    hardware_version: Annotated[int, Field(ge=0, lt=2**16)] | None = Field(
        None,
        description="Hardware version (0x2003:02) of an EPOS2 whose type labrig does not know by it, as a 24/2: labrig "
        "devices check states it. A drive with another one is refused. null: only known types [-].",
    )
    homing: Epos2Homing = Field(default_factory=Epos2Homing, description="How the axis gets its reference.")
    configuration_fingerprint: (
        tuple[Annotated[int, Field(ge=0, lt=2**32)], Annotated[int, Field(ge=0, lt=2**32)]] | None
    ) = Field(
        None,
        description="Date and time in 0x1020 of the drive, which it clears when a parameter is changed; a drive with "
        "other values is refused. null: not compared [-].",
    )
    limit_switches: tuple[Literal["negative", "positive"], ...] = Field(
        (), description="Limit switches that are wired and must stop the drive. By default it ignores them."
    )

    @property
    def nodes(self) -> tuple[int, ...]:
        """The node id."""
        return (self.node_id,)

    @property
    def analog_inputs(self) -> tuple[str, ...]:
        """Names of the analog inputs of the drive."""
        return tuple(ANALOG_INPUTS)

    def scale_of(self, gear_ratio: float, travel_per_turn: float) -> AxisScale:
        """Return the conversion to quadcounts (quarters of an encoder line) and rpm."""
        quadcounts = 4 * (self.encoder_pulses_per_turn or 0)
        return AxisScale(quadcounts, gear_ratio, travel_per_turn, self.reversed)

    def homing_current_ma(self, method: int) -> int | None:
        """Return the current at which a method finds its stop [mA]; None for a method without a current."""
        return self.homing.current_threshold_ma if method in BY_CURRENT else None

    def scale_conflicts(self, scale: AxisScale) -> Iterator[Conflict]:
        """Yield limits and speeds that the drive cannot represent."""
        yield from super().scale_conflicts(scale)
        rpm = self.max_speed * scale.speed_units_per_speed
        if rpm > MAX_RPM:
            yield Conflict(
                "max_speed",
                f"max_speed is {rpm:.0f} rpm of the motor, the drive's limit is {MAX_RPM} rpm",
                f"write {scale.to_speed(MAX_RPM):.4g} or less, or check gear_ratio and lead_mm",
            )


def drive_settings(axis: Epos2Axis, heartbeat: HeartbeatDescription) -> dict[Entry, int]:
    """Return the settings of the drive of an axis, in quadcounts and rpm.

    Raises
    ------
    InputError
        When gear, lead or encoder is unknown.
    """
    scale = axis.scale()
    acceleration = scale.to_acceleration_units(axis.acceleration)
    switches = sum(_SWITCH_BITS[switch] for switch in set(axis.limit_switches))
    return {
        co.MAX_FOLLOWING_ERROR: scale.to_distance_counts(axis.max_following_error),
        co.POSITION_WINDOW: scale.to_distance_counts(axis.position_window),
        co.POSITION_WINDOW_TIME: axis.position_window_time_ms,
        co.MAX_PROFILE_VELOCITY: min(MAX_RPM, scale.to_speed_units(axis.max_speed)),
        co.PROFILE_ACCELERATION: acceleration,
        co.PROFILE_DECELERATION: acceleration,
        co.QUICK_STOP_DECELERATION: scale.to_acceleration_units(axis.quick_stop_deceleration),
        co.PROFILE_TYPE: 0,
        od.LIMIT_EXECUTION_MASK: od.LIMIT_EXECUTION_MASK.default | switches,
        co.CONSUMER_HEARTBEAT: heartbeat.computer_node_id << 16 | heartbeat.timeout_ms,
    }


def fingerprint(settings: Mapping[Entry, int]) -> tuple[int, int]:
    """Return the date and time in 0x1020 for these settings; the drive clears both when one is changed."""
    text = ";".join(f"{entry.place}={value}" for entry, value in settings.items())
    return zlib.crc32(text.encode()), len(settings)
