"""A drive as a CANopen node: its objects by SDO, its identity, and what it says by itself.

What is decided here
--------------------
- Nothing counts until it has been read back. Only settings that differ are written, none out of the range of the EDS
  file. What vouches for the drive's configuration is written back afterwards.
- A lost heartbeat, an EMCY and a boot-up of the drive become errors at the next call of `check`.
- If the EDS file cannot be read, the widths of the standard are used: enough to stop the drive; `identify` refuses it.
- Uncertain until tried on a device: whether two nodes with one id both answer (on a wire they may destroy each other's
  frames and seem silent).
"""

import math
import struct
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from functools import cached_property
from typing import TypeVar

from labrig.clock import Clock
from labrig.devices.axis_description import AxisDescription
from labrig.devices.bus import CanLink
from labrig.devices.can_description import HeartbeatDescription
from labrig.devices.drives import objects as co
from labrig.devices.drives.drive import Identity, raise_together
from labrig.devices.drives.eds import count_bytes, find_bounds, read_own_eds
from labrig.devices.drives.errors import describe_emergency
from labrig.devices.drives.model import Model
from labrig.devices.drives.objects import Place
from labrig.devices.drives.sdo import CHECK_POWER, NO_OBJECT, SdoClient
from labrig.devices.units import AxisScale
from labrig.errors import (
    HEARTBEAT_LOST,
    NOT_OPERATIONAL,
    DriveError,
    DriveFaultError,
    DriveRefusedError,
    DriveRestartedError,
    DriveSilentError,
    DriveStrayedError,
    Fault,
    InputError,
)

NMT_START, NMT_STOP, NMT_PRE_OPERATIONAL, NMT_RESET_COMMUNICATION = 0x01, 0x02, 0x80, 0x82
NMT_STOPPED, NMT_OPERATIONAL = 0x04, 0x05
_NMT_STATES = {NMT_STOPPED: "stopped", 0x7F: "pre-operational"}

_CLASHING_ANSWERS = 3
"""Unexpected answers while a drive is identified that show two nodes; a single one may be a repeated frame."""

_PROFILE = 402
_EMERGENCY = struct.Struct("<HB")
_PDOS = frozenset((*range(0x1400, 0x1600), *range(0x1800, 0x1A00)))
"""Indices of receive and of transmit PDOs."""

_T = TypeVar("_T")


class DriveNode:
    """One drive on a CANopen bus; its parameters are those of `Cia402Drive`.

    Attributes
    ----------
    model : Model
        What is known of the product.
    variables : dict of Place to ODVariable
        Its objects as the EDS file describes them, or as the standard does if they are not there.
    """

    def __init__(self, link: CanLink, section: AxisDescription, axis: str, clock: Clock) -> None:
        self.node_id = section.node_id
        self.name = f"drive of axis {axis} (node {self.node_id})"
        self.axis = axis
        self.section = section
        self.model = Model(read_own_eds("cia402.eds"))
        with suppress(InputError):  # `read_identity` raises it
            self.model = section.model()
        self.variables = {**read_own_eds("cia402.eds").objects, **self.model.eds.objects}
        self.sdo = SdoClient(link, self.node_id, self.name, axis)
        self.has_restarted = False
        self._clock = clock
        self._link = link
        self._fingerprint: tuple[int, ...] = ()
        self._emergency: tuple[int, int] | None = None
        self._heard_s, self._silence_s = 0.0, math.inf
        self._nmt_state: int | None = None
        link.network.subscribe(0x700 + self.node_id, self._on_heartbeat)
        link.network.subscribe(0x080 + self.node_id, self._on_emergency)
        link.network.subscribe(0x000, self._on_nmt)

    @cached_property
    def scale(self) -> AxisScale:
        """The conversion to counts and speeds of the drive. Raises `InputError` if an entry is unknown."""
        return self.section.scale()

    # Objects

    def upload(self, place: Place) -> int:
        """Return the value of an object. Raises `DriveSilentError`, `DriveRefusedError`, `BusError`."""
        variable = self.variables[place]
        return int(variable.decode_raw(self.sdo.upload(place, variable.name)[: count_bytes(variable)]))

    def find(self, place: Place) -> int | None:
        """Return the value of an object; None if the drive does not have it. Raises as `upload`."""
        if not self.model.has(place):
            return None
        try:
            return self.upload(place)
        except DriveRefusedError as error:
            if error.code != NO_OBJECT:
                raise
        return None

    def download(self, place: Place, value: int) -> None:
        """Write an object. Raises `DriveError` if the value is out of range, and as `upload`."""
        variable = self.variables[place]
        low, high = find_bounds(variable)
        if not low <= value <= high:
            raise DriveError(
                f"{self.name} does not take {variable.name} ({place}) = {value}, only {low} to {high}",
                "compare units and limits of this axis in the rig file with the drive's EDS file",
            )
        self.sdo.download(place, variable.encode_raw(value), f"{variable.name} ({place}) = {value}")

    def _ensure(self, place: Place, value: int) -> bool:
        """Write an object if it differs, and read it back; return whether it was written."""
        if self.upload(place) == value:
            return False
        self.download(place, value)
        found = self.upload(place)
        if found != value:
            raise DriveError(
                f"{self.name} kept {self.variables[place].name} ({place}) at {found} when {value} was written",
                f"check whether the drive's parameters are locked in {self.model.tool}",
            )
        return True

    def adjust(self, settings: Mapping[Place, int]) -> None:
        """Write the settings that differ; the drive keeps its fingerprint. Raises `DriveError`."""
        # One that has restarted may be another drive: it keeps what it says now.
        kept = self.read_fingerprint() if self.has_restarted else self._fingerprint
        written = [self._ensure(place, value) for place, value in settings.items()]
        if any(written) and kept:
            for place, value in zip(self.model.fingerprint, kept, strict=True):
                self._ensure(place, value)

    # Connecting

    def identify(self) -> Identity:
        """Return the identity of the drive after comparing it with its section; nothing is written.

        Raises
        ------
        DriveError
            When it is another product, has other units or another encoder than the rig file says, or has been changed,
            or when two drives answer.
        InputError
            When its EDS file cannot be read.
        """
        identity = self.read_identity()
        raise_together([*self.find_differences()])
        return identity

    def read_identity(self) -> Identity:
        """Return the identity of the drive, whatever its settings. Raises as `identify`."""
        self.section.model()
        self._do_awake(lambda: self.upload(co.VENDOR_ID))
        strays = self.sdo.strays
        identity = self._compare_product()
        if self.sdo.strays - strays >= _CLASHING_ANSWERS:
            raise DriveError(
                f"{self.name}: two nodes answer as node {self.node_id}",
                "give every drive a node id of its own",
            )
        return identity

    def _compare_product(self) -> Identity:
        model, eds = self.model, self.model.eds
        profile, vendor = self.upload(co.DEVICE_TYPE) & 0xFFFF, self.upload(co.VENDOR_ID)
        code, revision = self.upload(co.PRODUCT_CODE), self.find(co.REVISION)
        found = {"product_code": code} | ({} if revision is None else {"revision_number": revision})
        known = model.types or {eds.product: eds.product_name}
        name = known.get(code & model.type_mask)
        is_own = name is not None and (model.revisions is None or revision in model.revisions)
        if (profile, vendor, is_own) != (_PROFILE, eds.vendor, True):
            says = ", ".join(f"{key.replace('_', ' ')} 0x{value:08X}" for key, value in found.items())
            types = ", ".join(f"{each} (0x{known_code:08X})" for known_code, each in known.items())
            raise DriveError(
                f"{self.name} is no {eds.product_name} that labrig knows: profile {profile}, "
                f"vendor 0x{vendor:X}, {says}",
                f"profile {_PROFILE}, vendor 0x{eds.vendor:X}, {types} are known; {model.advice}",
            )
        doubt = ""
        if eds.revision is not None and revision not in {None, eds.revision}:
            doubt = f"its EDS file is for revision 0x{eds.revision:08X}: ranges and defaults may differ"
        unguarded = ""
        if self.find(co.ABORT_CONNECTION) is None:
            unguarded = f"it has no object {co.ABORT_CONNECTION}: it may move on when labrig falls silent"
        return Identity(name or "", self.find(co.SERIAL_NUMBER), found, doubt, unguarded)

    def find_differences(self) -> Iterator[DriveError]:
        """Yield what differs from the section and is never written: encoder, units, and the parameters as a whole."""
        for stated in self.model.stated:
            found = stated.read(self.upload(stated.place)) if self.model.has(stated.place) else None
            if found not in {None, stated.value}:
                value = stated.value
                said = f"{value:g}" if isinstance(value, float) else value or "nothing"
                yield DriveError(
                    f"{self.name} has {stated.key} {found} ({stated.place}), the rig file says {said}",
                    f"find out which is right; correct the rig file, or the drive in {self.model.tool}",
                )
        expected = self.model.expected_fingerprint
        if expected is not None and (own := self.read_fingerprint()) != expected:
            yield DriveError(
                f"{self.name} has the configuration fingerprint {list(own)}, the rig file says {list(expected)}: its "
                "parameters have been changed",
                "with no needle in tissue, power it off and on, which restores its stored parameters; if that does not "
                f"help, compare them in {self.model.tool} and enter the new fingerprint in the rig file",
            )

    def read_fingerprint(self) -> tuple[int, ...]:
        """Return what the drive clears when a setting is changed; empty if it has no such objects."""
        return tuple(self.upload(place) for place in self.model.fingerprint)

    def send_nmt(self, command: int) -> None:
        """Send an NMT command to this node; NMT is not answered: its next heartbeat tells its state."""
        self._nmt_state = None
        self._link.send(0x000, bytes([command, self.node_id]))

    def _do_awake(self, act: Callable[[], _T]) -> _T:
        """Do something, and again once the node has been woken if it does not answer and may be in NMT stopped."""
        try:
            return act()
        except DriveSilentError:
            if self._nmt_state == NMT_OPERATIONAL:
                raise
            self.send_nmt(NMT_PRE_OPERATIONAL)
            return act()

    # Stopping by itself

    def _make_stop_by_itself(
        self, heartbeat: HeartbeatDescription, *, reports: bool
    ) -> dict[Place, int | None]:
        """Make the drive stop when the computer's heartbeat does, and obey nobody else.

        Parameters
        ----------
        heartbeat : HeartbeatDescription
            The computer's.
        reports : bool
            Whether the transmit PDO of the report stays on.

        Returns
        -------
        dict of Place to int or None
            The settings as they were read back; None for an object that the drive does not have.

        Raises
        ------
        DriveError
            When it does not keep one of the settings, among them an option that means "no action".
        """
        used = {co.REPORT_COB_ID} if reports else set()
        unused = [
            place
            for place in self.model.eds.objects
            if place.index in _PDOS and place.subindex == 1 and place not in used and self.model.takes(place)
        ]
        settings = {
            **self._consume(heartbeat),
            **{place: value for place, value in self.model.stop_options.items() if self.model.has(place)},
            **{place: self.upload(place) | co.PDO_INVALID for place in unused},
        }
        kept: dict[Place, int | None] = {}
        for place, value in settings.items():
            self._clock.sleep(0.0)  # lets a heartbeat that is due be sent
            try:
                self._ensure(place, value)
                kept[place] = value
            except DriveError as error:
                if not isinstance(error, DriveRefusedError) or error.code != NO_OBJECT:
                    raise error.reword(
                        f"{error.message}: it cannot be relied upon to stop when labrig ends",
                        f"set {place} in {self.model.tool} and save it; nothing else stops this drive then",
                    ) from error
                kept[place] = None
        return kept

    # What the drive says by itself

    def _watch(self, heartbeat: HeartbeatDescription) -> None:
        """Switch the drive's heartbeat on; it counts as silent after the timeout without one."""
        self.adjust({co.PRODUCER_HEARTBEAT: heartbeat.period_ms})
        self._heard_s, self._silence_s = self._clock.now_s(), heartbeat.timeout_ms / 1000

    def _consume(self, heartbeat: HeartbeatDescription) -> dict[Place, int]:
        """Return the setting with which the drive misses the computer's heartbeat."""
        return {co.CONSUMER_HEARTBEAT: heartbeat.computer_node_id << 16 | heartbeat.timeout_ms}

    def check(self, *, operational: bool = False) -> None:
        """Raise a restart, emergency or silence that was noticed; send nothing to the drive.

        Parameters
        ----------
        operational : bool
            Whether its heartbeat has to say so too, since it was started.

        Raises
        ------
        DriveRestartedError, DriveFaultError, DriveSilentError, DriveStrayedError
        """
        if self.has_restarted:
            raise DriveRestartedError(
                f"{self.name} has restarted: it lost power, its position and its reference",
                "find out why it lost power; do not home while a needle is in tissue",
            )
        if self._emergency is not None:
            raise self._make_fault(*self._emergency)
        silent_s = self._clock.now_s() - self._heard_s
        if silent_s > self._silence_s:
            raise DriveSilentError(
                f"{self.name} has sent no heartbeat for {silent_s:.2f} s, expected one every "
                f"{self._silence_s:g} s at the latest",
                CHECK_POWER,
                fault=HEARTBEAT_LOST,
                axis=self.axis,
            )
        if operational and self._nmt_state not in {None, NMT_OPERATIONAL}:
            state = _NMT_STATES.get(self._nmt_state, f"0x{self._nmt_state:02X}")
            raise DriveStrayedError(
                f"the {self.name} is in NMT state {state}, expected operational",
                "find out which program on the bus sends NMT commands",
                fault=NOT_OPERATIONAL,
            )

    def _find_error_code(self) -> int:
        """Return the code of the newest error that the drive reports; 0 without one."""
        if code := self.find(co.ERROR_CODE):
            return code
        return self.upload(co.LAST_ERROR) & 0xFFFF if self.find(co.ERROR_COUNT) else 0

    def _make_fault(self, code: int, register: int) -> DriveFaultError:
        """Return the error of a fault of the drive."""
        text, remedy = describe_emergency(code, self.model.errors)
        return DriveFaultError(
            f"{self.name} is in fault: error 0x{code:04X}, {text} (error register 0x{register:02X})",
            remedy,
            fault=Fault("emergency", code, register, text),
        )

    def _on_heartbeat(self, _can_id: int, data: bytearray, _timestamp: float) -> None:
        self._heard_s = self._clock.now_s()
        if data[:1] == b"\0":
            self.has_restarted = True
        elif data:
            self._nmt_state = data[0] & 0x7F

    def _on_nmt(self, _can_id: int, data: bytearray, _timestamp: float) -> None:
        """Note the NMT command of somebody else: labrig's own do not come back."""
        if len(data) == 2 and data[1] in {0, self.node_id}:
            self._nmt_state = NMT_STOPPED if data[0] == NMT_STOP else NMT_OPERATIONAL

    def _on_emergency(self, _can_id: int, data: bytearray, _timestamp: float) -> None:
        if len(data) >= _EMERGENCY.size:
            code, register = _EMERGENCY.unpack_from(data)
            self._emergency = (code, register) if code else None
