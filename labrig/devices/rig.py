"""The opened rig: axes, camera, clock, operator and state; and the rules that hold across them."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from typing import NoReturn, TypeVar

from labrig.devices.axis import Axis, AxisReadback, Setpoint
from labrig.devices.axis_description import AXES
from labrig.devices.axis_positions import collect_axis_positions
from labrig.devices.bus import CanLink
from labrig.devices.bus_watch import BusWatch
from labrig.devices.camera import Camera, PictureSource, close_source
from labrig.devices.clocks import MAX_STEP_S
from labrig.devices.commands import CommandFormatter
from labrig.devices.control import StopRequests, acquire_rig
from labrig.devices.drive import Homing, Identity, open_drive, raise_together, wait_for_all
from labrig.devices.hardware import Hardware, make_hardware
from labrig.devices.heartbeat import Gap, HeartbeatClock
from labrig.devices.homing import HOMING_HERE, require_homing_allowed
from labrig.devices.load_guard import LoadGuard
from labrig.devices.motion_log import MotionLog
from labrig.devices.needle_location import AxisLocation, NeedleLocation
from labrig.devices.needle_state import NeedleState, RigState
from labrig.devices.operator import (
    NO_OFFER,
    Answer,
    ConfirmFaultReset,
    Offer,
    Operator,
    OperatorRequest,
)
from labrig.devices.past_insertion import PastInsertion
from labrig.devices.position_supervision import (
    AxisBounds,
    InMotion,
    PositionReading,
    SupervisionState,
    supervise_position,
)
from labrig.devices.rig_calls import Photograph
from labrig.devices.rig_file import RigDescription, require_complete
from labrig.errors import (
    HEARTBEAT_LOST,
    POSITION_JUMPED,
    BusError,
    BusPassiveError,
    CameraError,
    DiskError,
    DriveError,
    DriveRestartedError,
    DriveSilentError,
    DriveStrayedError,
    InputError,
    InterruptedRunError,
    LimitError,
    MachineError,
    SafetyStopError,
    fault_of,
)

_T = TypeVar("_T")

Interrupted = Callable[[], str | None]
"""Returns the name of a signal that has arrived, or None."""

_SYNC = 0x080
_HOMING_LOOK_S = 0.005

_LOOK_S = 0.15
"""Time after the last reading at which a rig that waits or asks reads its axes again [s]."""

_PROMPT_S = 0.25
"""What is done aside and takes longer is interrupted by signals too, and by requests to stop [s]."""

_STOOD_STILL = "labrig itself stood still"
_SUSPENDED = "the computer was suspended"
_STAY_AWAKE = "keep the computer awake, as by: systemd-inhibit labrig run ...; then start again"
_TARGET_LOOK_S = 0.15
"""Shortest time between two readings of targets [s]."""


@dataclass(frozen=True)
class Opening:
    """Which parts of a rig are opened, and how.

    Parameters
    ----------
    axes : tuple of str
        The axes; the others need not be connected, nor complete in the rig file.
    camera : bool
        Whether the camera is opened too.
    max_current_ma : mapping of str to int
        Axis -> limit of its output current while it is open, besides that of the rig file [mA].
    reset_faults : bool
        Whether the operator may confirm the reset of a fault; otherwise a drive in fault is refused.
    hold_inputs : bool
        Whether limits of inputs hold. A withdrawal goes as the person at the rig confirms: an open door or a force
        must not keep the needle in the tissue.
    power : bool
        Whether power is switched on at once; a run does so when it has its record.
    """

    axes: tuple[str, ...] = AXES
    camera: bool = True
    max_current_ma: Mapping[str, int] = field(default_factory=dict)
    reset_faults: bool = False
    hold_inputs: bool = True
    power: bool = True


WHOLE = Opening()
"""The whole rig, as a run has it."""


class Rig:
    """An opened rig; made by `open_rig`.

    Parameters
    ----------
    description : RigDescription
        Its rig file.
    hardware : Hardware
        Bus, camera, clock and operator.
    link : CanLink
        The bus of the drives.
    source : PictureSource or None
        Source of the pictures; None without the camera.
    person : Operator
        Answers if the hardware has no operator of its own.
    interrupted : callable
        Called between two bus transactions; returns a signal that has arrived.
    insisted : callable or None
        The same while a device keeps labrig waiting: a signal that only asks for a pause stops then, since no safe
        point may come. By default `interrupted`.
    stop_requests : StopRequests or None
        Requests of another labrig to stop.
    opening : Opening
        Which parts are opened, and how.
    needle : NeedleState or None
        State across runs; by default that of its state file.
    doing : str
        What the rig is used for.
    alert : callable
        Tells the person at the rig at once, before anything else is done, that the drives are lost.

    Attributes
    ----------
    axes : tuple of Axis
        The open axes; in a run all three.
    """

    def __init__(
        self,
        description: RigDescription,
        *,
        hardware: Hardware,
        link: CanLink,
        source: PictureSource | None,
        person: Operator,
        interrupted: Interrupted,
        insisted: Interrupted | None = None,
        stop_requests: StopRequests | None = None,
        opening: Opening = WHOLE,
        needle: NeedleState | None = None,
        doing: str = "labrig",
        alert: Callable[[str], None] = lambda _text: None,
    ) -> None:
        self.description = description
        self._opening = opening
        self.clock = hardware.clock
        self.operator = hardware.operator or person
        self._person = person
        self.needs_person = hardware.operator is None
        self.state_period_s = 1 / description.recording.state_rate_hz
        self._hardware = hardware
        self._interrupted = interrupted
        self._insisted = insisted or interrupted
        self._stop_requests = stop_requests
        self.needle = needle or NeedleState(description.state_path, do=self.do_aside)
        self._motions = MotionLog(description.state_path, hardware.clock.utc, doing, self.do_aside)
        self._identities: dict[str, Identity] = {}
        self._link = link
        self._step_s = min(MAX_STEP_S, description.can.heartbeat.period_ms / 1000)
        self._heartbeat = HeartbeatClock(self.clock, link, description.can.heartbeat)
        self._axes = self._open_axes(replace(link, attend=self._attend))
        self.axes = tuple(self._axes.values())
        worker = hardware.camera_worker
        self._camera = (
            source if source is None else Camera(source, description.camera, self._heartbeat, worker)
        )
        self._watch = self._watch_bus(link)
        self._read_s = self._target_s = 0.0
        self._is_watching = False
        self._bounds = {axis.name: AxisBounds.of(axis.name, axis.description) for axis in self.axes}
        self._supervised = dict.fromkeys(self._axes, SupervisionState())
        self._targets_due = list(self._axes)
        self._limits_found = self.needle.state.current_limits
        self._load = LoadGuard(holds_inputs=opening.hold_inputs)
        self._alert = alert
        self._positions: dict[str, tuple[float, float]] = {}
        self._unknown_motion = ""
        self._lost_zeros: set[str] = set()
        self._has_power = self._is_ending = False

    def _watch_bus(self, link: CanLink) -> BusWatch:
        nodes = {node: axis.name for axis in self.axes for node in axis.description.nodes}
        return BusWatch(link, nodes, self.description.can.heartbeat, CommandFormatter(self.description))

    def _open_axes(self, link: CanLink) -> dict[str, Axis]:
        return {
            name: Axis(name, axis, open_drive(link, axis, name, self._heartbeat), self._heartbeat)
            for name, axis in self.description.axes.items()
            if name in self._opening.axes
        }

    # State

    def axis(self, name: str) -> Axis:
        """Return an axis by its name: insertion, rotation or linear. Raises `InputError` if it is not open."""
        if name not in self._axes:
            raise InputError(f"axis {name} is not open", f"open are: {', '.join(self._axes)}")
        return self._axes[name]

    @property
    def referenced(self) -> frozenset[str]:
        """The axes that have their reference."""
        return frozenset(axis.name for axis in self.axes if axis.referenced)

    @property
    def insertion(self) -> Axis:
        """The screw that pushes the needle out of the sheath."""
        return self.axis("insertion")

    @property
    def rotation(self) -> Axis:
        """The axis that turns the needle."""
        return self.axis("rotation")

    @property
    def linear(self) -> Axis:
        """The module that carries the instrument with the sheath."""
        return self.axis("linear")

    @property
    def camera(self) -> Camera:
        """The camera. Raises `CameraError` if the rig was opened without it."""
        if self._camera is None:
            raise CameraError(
                "the rig is open without its camera", "open it with its camera to take pictures"
            )
        return self._camera

    @property
    def state(self) -> RigState:
        """The state of the rig across runs."""
        return self.needle.state

    def truth(self) -> tuple[dict[str, object], ...]:
        """Return the truth of the insertion that the camera shows, one dict; nothing if it is unknown."""
        return () if self.description.camera.recorded else self._hardware.truth()

    def recall(self, insertions: Sequence[PastInsertion]) -> None:
        """Repeat in a simulated world what earlier sessions of this run did, once the needle is mounted."""
        self._hardware.recall(insertions)

    def describe(self) -> dict[str, object]:
        """Return the rig and the state of its devices, ready for JSON."""
        return {
            "rig": self.description.name,
            "kind": self.description.kind,
            "bus": self.description.can.model_dump(),
            "axes": {
                axis.name: {**axis.describe(), "drive": self._identities[axis.name].document()}
                for axis in self.axes
            },
            "camera": None if self._camera is None else self._describe_camera(self._camera),
            "snapshot": self.snapshot(),
            "state": {**asdict(self.state), "current_limits": self._limits_found},
        }

    def snapshot(self) -> dict[str, object]:
        """Return the present state of the devices, ready for JSON; for one that does not answer, the reason."""
        camera = self._camera
        return {
            "axes": {axis.name: _ask_device(partial(self._read_axis, axis)) for axis in self.axes},
            "camera": None if camera is None else _ask_device(partial(camera.read_settings, self._hold)),
            "state": asdict(self.state),
        }

    def _read_axis(self, axis: Axis) -> dict[str, object]:
        """Return position and state of an axis; the position alone while power is off."""
        if not self._has_power:
            return {f"position_{axis.unit}": axis.drive.position()}
        read = axis.read()
        position = {f"position_{axis.unit}": read.position}
        return {**position, "statusword": read.statusword, "drive_state": read.state.name}

    def _describe_camera(self, camera: Camera) -> dict[str, object]:
        return {
            "driver": self.description.camera.driver,
            "device": self.description.camera.address,
            **({"recorded_pictures": True} if self.description.camera.recorded else {}),
            "asked": dict(camera.settings.asked),
            "readback": dict(camera.settings.readback),
            **({"reported": dict(camera.settings.reported)} if camera.settings.reported else {}),
        }

    # Moving

    def read_states(self) -> dict[str, AxisReadback]:
        """Read every axis, all at one instant: that of a SYNC.

        Raises
        ------
        DriveError, BusError
            When one of them cannot continue; all that answer have been stopped.
        """
        try:
            for axis in self.axes:
                axis.drive.expect_report()
            # Before the SYNC: a busy computer may be held up after the drives have measured.
            self._read_s = self.clock.now_s()
            self._link.send(_SYNC, b"")
            states = {name: axis.read() for name, axis in self._axes.items()}
            self._positions |= {name: (self._read_s, state.position) for name, state in states.items()}
            self._supervise_positions({name: state.position for name, state in states.items()})
            self._load.require_inputs(self.axes, {name: state.inputs for name, state in states.items()})
        except MachineError as error:
            self._stop_because_of(error)
        return states

    def _look(self) -> None:
        """Ask every axis where it is, while nobody reads states."""
        self._read_s = self.clock.now_s()
        readings = {name: axis.drive.read() for name, axis in self._axes.items()}
        positions = {name: reading.position for name, reading in readings.items()}
        self._positions |= {name: (self._read_s, position) for name, position in positions.items()}
        self._supervise_positions(positions)
        self._load.require_inputs(self.axes, {name: reading.inputs for name, reading in readings.items()})

    def _supervise_positions(self, positions: Mapping[str, float]) -> None:
        """Require that each axis is where it should be, and that each in motion has the target that was sent.

        If none moves, the targets are read in turn. Raises `DriveStrayedError`.
        """
        if not self._is_watching:
            return
        errors = [self._judge(name, position) for name, position in positions.items()]
        raise_together([error for error in errors if error is not None])
        if self._read_s - self._target_s >= _TARGET_LOOK_S:
            self._target_s = self._read_s
            self._targets_due = [*self._targets_due[1:], self._targets_due[0]]
            moving = [name for name, axis in self._axes.items() if isinstance(axis.expected, InMotion)]
            for name in moving or self._targets_due[:1]:
                self._axes[name].require_target()

    def _judge(self, name: str, position: float) -> DriveStrayedError | None:
        """Return the error of an axis that is not where it should be; one that jumped has lost its reference."""
        axis = self._axes[name]
        reading = PositionReading(self._read_s, self.clock.now_s(), position)
        self._load.note_position(axis, reading)
        self._supervised[name], error = supervise_position(
            self._bounds[name], self._supervised[name], axis.expected, reading
        )
        if error is not None and error.fault is POSITION_JUMPED:
            self._lost_zeros.add(name)
        return error

    def take_picture(self) -> Photograph:
        """Take a picture between two readings of the axes.

        The positions are interpolated to the time of the camera or, without one, half-way. At 1 mm/s their error is a
        few hundredths of a millimetre.

        Raises
        ------
        CameraError
            Also when the picture is identical to the last one although needle or sheath has moved.
        DriveError, BusError
        """
        before, before_s = collect_axis_positions(self.read_states()), self._read_s
        frame = self.camera.capture(self._make_meanwhile(self._insisted))
        after = collect_axis_positions(self.read_states())
        self.camera.require_new(frame, (after.insertion_mm, after.linear_mm))
        frame = frame.between(before_s, self._read_s)
        positions = before.interpolate_to(after, 0.5 if frame.fraction is None else frame.fraction)
        return Photograph(frame.image, frame.t_s, positions, frame.t_bound_s, frame.fraction)

    def start_move(self, axis_name: str, position: float, speed: float) -> Setpoint:
        """Start a move of an axis [mm or rad, per s] and return at once. Raises as `Axis.start_move`."""
        return self.axis(axis_name).start_move(position, speed)

    def wait(self, duration_s: float) -> None:
        """Let rig time pass while axes move, and watch for signals and reports of the drives.

        Raises
        ------
        InterruptedRunError
            When a signal has arrived; the axes have been stopped.
        DriveError
            When a drive has reported a fault or has restarted; the axes have been stopped.
        """
        step_s = self._step_s
        if self._is_watching:
            step_s = min(step_s, self._load.period_s(self.axes))
        steps = max(1, math.ceil(duration_s / step_s))
        try:
            self.supervise()
            for _ in range(steps):
                self.clock.sleep(duration_s / steps)
                self.supervise()
        except (InterruptedRunError, MachineError) as error:
            self._stop_because_of(error)

    def supervise(self) -> None:
        """Check bus, drives and signals, and only then send a heartbeat if one is due; read axes not read for long.

        Call it more often than the heartbeat period while nothing else lets rig time pass; `wait` calls it.

        Raises `InterruptedRunError`, `BusError`, `DriveError`.
        """
        self._supervise(requests=self._interrupted)

    def _supervise(self, *, requests: Interrupted | None) -> None:
        self._check(requests=requests)
        self._heartbeat.beat()
        if not self._is_watching:
            return
        if self.clock.now_s() - self._read_s >= _LOOK_S:
            self._look()
        self._load.require_moving(self.axes, self.clock)

    def _attend(self) -> None:
        """Let the beat go on between two answers; without power, however long an exchange takes."""
        if not self._has_power:
            self._heartbeat.note_supervision()
        self._heartbeat.attend()

    def do_aside(self, call: Callable[[], _T]) -> _T:
        """Do what may block (a disk, a long computation) in another thread, and supervise meanwhile.

        Once the run is ending, the axes stand still, and nothing but what `call` raises is raised.

        Raises
        ------
        InterruptedRunError, SafetyStopError, BusError, DriveError
            The axes have been stopped, and `call` goes on. Signals and requests to stop are looked for when it takes
            longer than `_PROMPT_S`: what takes no longer is in the record as a whole or not at all.
        """
        return self._hardware.disk_worker.do(call, self._make_meanwhile())

    def _make_meanwhile(self, interrupted: Interrupted | None = None) -> Callable[[], None]:
        """Return what is to be called again and again while something is done aside that begins now."""
        interrupted = interrupted or self._interrupted
        if self._is_ending:
            return self._hold
        prompt_s = self.clock.now_s() + _PROMPT_S

        def supervise() -> None:
            try:
                self._supervise(requests=interrupted if self.clock.now_s() > prompt_s else None)
            except (InterruptedRunError, MachineError) as error:
                self._stop_because_of(error)

        return supervise

    def _hold(self) -> None:
        """Supervise axes that stand still and are not going to move; if anything is wrong, the beat ends."""
        try:
            self._supervise(requests=None)
        except MachineError:
            self._heartbeat.silence()

    def ask(
        self,
        request: OperatorRequest,
        offer: Offer = NO_OFFER,
        *,
        also: Callable[[], None] = lambda: None,
        of_person: bool = False,
    ) -> Answer:
        """Let the operator do something; meanwhile the axes hold still and are supervised.

        Parameters
        ----------
        request : OperatorRequest
            What is asked.
        offer : Offer
            What a person may choose instead; an operator that is no person is offered nothing.
        also : callable
            Called together with the supervision.
        of_person : bool
            Whether a person is asked even where another operator answers, as on a simulated rig.

        Raises
        ------
        InterruptedRunError, SafetyStopError, BusError, DriveError
            The axes have been stopped.
        """

        def meanwhile() -> None:
            self.supervise()
            also()

        try:
            if of_person or self.needs_person:
                operator = self._person if of_person else self.operator
                return operator.ask(request, meanwhile, offer)
            return self.operator.ask(request, meanwhile)
        except (InterruptedRunError, MachineError) as error:
            self._stop_because_of(error)

    def note_motion(self, axis_name: str, what: str) -> AbstractContextManager[None]:
        """Log that an axis is moved outside a run, at the start and the end of the block.

        Raises
        ------
        DiskError
            Before the block starts.
        """
        return self._motions.note_motion(self.axis(axis_name), what)

    def take_can_frames(self) -> list[tuple[float, int, bytes, str]]:
        """Return the CAN frames since the last call: rig time [s], COB-ID, data, T or R for sent or received."""
        return self._link.network.take_frames()

    def _check(self, *, requests: Interrupted | None) -> None:
        self._require_awake()
        if self._link.trouble is not None:
            raise self._link.trouble
        if requests is not None:
            self._check_requests(requests)
        if self._is_watching:
            self._watch.require_no_command()
        for axis in self.axes:
            axis.drive.check()
        if self._is_watching:
            self._watch.require_operational()

    def _check_requests(self, interrupted: Interrupted) -> None:
        """Raise what a signal, or another labrig, asks for."""
        signal_name = interrupted()
        if signal_name is not None:
            raise InterruptedRunError(f"interrupted by {signal_name}")
        if self._stop_requests is not None and self._stop_requests.poll():
            raise SafetyStopError(
                "stopped by labrig devices stop", "find out who stopped it and why, then start again"
            )

    def stop(self) -> None:
        """Stop every axis and verify that each stands still; a failure of one axis does not affect the others.

        Takes at most max_speed / acceleration + 0.5 s, and as long again with a quick stop.

        Raises
        ------
        SafetyStopError
            When an axis may still move; names each such axis and the reason.
        """
        failures = [
            *_try_each(self.axes, lambda axis: axis.drive.post_stop()),
            *_try_each(self.axes, Axis.halt),
            *self._wait_until_still().values(),
        ]
        if self._stop_requests is not None:
            self._stop_requests.answer(failures)
        self._unknown_motion = "not every axis is known to stand still" if failures else ""
        if failures:
            self._heartbeat.silence()
            raise SafetyStopError(
                "not known to stand still: " + "; ".join(dict.fromkeys(failures)),
                "press the emergency stop, then see labrig devices check",
            )

    def _wait_until_still(self) -> dict[str, str]:
        return wait_for_all({axis.name: axis.wait_until_still() for axis in self.axes}, self._heartbeat)

    def _stop_because_of(self, error: InterruptedRunError | MachineError) -> NoReturn:
        """Stop everything and raise the error, with what failed meanwhile. Tell first if drives are lost."""
        explained = self._explain_own_standstill(error)
        if _has_lost_drives(error):
            self._heartbeat.note_loss()
        if explained is error and _has_lost_drives(error):
            recalled = self._recall_needle(self._name_lost(error))
            self._alert(f"{recalled.motion}\nlast positions: {recalled.where}")
        self._is_ending = True
        for end in (self.stop, self._forget_lost_zeros):
            try:
                end()
            except (SafetyStopError, DiskError) as failure:
                explained = explained.reword(f"{explained.message}; {failure.message}")
        if explained is error:
            raise error
        raise explained from error

    def _forget_lost_zeros(self) -> None:
        """Remember which axes have lost their reference. Raises `DiskError`."""
        self.needle.forget_references({*self._lost_zeros, *self._watch.without_zero})

    def _explain_own_standstill(
        self, error: InterruptedRunError | MachineError
    ) -> InterruptedRunError | MachineError:
        """Blame what a gap in labrig's own heartbeat has caused on what held labrig up, not on wiring or drives."""
        fault, gap = fault_of(error), self._heartbeat.find_gap()
        if fault is None or not gap.duration_s or _is_explained(error):
            return error
        if gap.suspended_s > self.description.can.heartbeat.timeout_ms / 1000:
            return error.reword(f"{_tell_suspension(gap)}: {error.message}", _STAY_AWAKE)
        if fault.code != HEARTBEAT_LOST.code:
            return error
        return error.reword(
            f"{_STOOD_STILL} for {gap.duration_s:.1f} s, so the drives stopped by themselves: {error.message}",
            "find out what held labrig up: Ctrl+Z, a debugger, a suspended computer, a disk that hangs; then start "
            "again",
        )

    def _require_awake(self) -> None:
        """Raise `SafetyStopError` once the computer has been suspended for so long that the drives have stopped."""
        if self._heartbeat.was_suspended():
            raise SafetyStopError(_tell_suspension(self._heartbeat.find_gap()), _STAY_AWAKE)

    def _name_lost(self, error: MachineError | InterruptedRunError) -> str:
        """Return which drives do not answer, for a sentence."""
        named = [axis.drive.name for axis in self.axes if axis.drive.name in error.message]
        return f"the {named[0]} does not answer" if len(named) == 1 else "the drives do not answer"

    # The needle's place

    def locate_needle(self) -> NeedleLocation:
        """Return where the needle is: positions that are read now, also from drives in fault, or else the last ones."""
        located = {axis.name: self._locate(axis) for axis in self.axes}
        return self._recall_needle(self._unknown_motion, located)

    def _recall_needle(
        self, unknown_motion: str, located: Mapping[str, AxisLocation] | None = None
    ) -> NeedleLocation:
        """Return where the needle was when the axes were last read; this asks no drive."""
        axes = located or {axis.name: self._recall_axis(axis, "") for axis in self.axes}
        state = self.state
        return NeedleLocation(unknown_motion, state.needle_in_tissue, state.doubt, tuple(axes.values()))

    def _locate(self, axis: Axis) -> AxisLocation:
        """Return where an axis is now; where it was last if its drive does not answer or has lost its position."""
        try:
            axis.drive.check()
        except (DriveRestartedError, DriveSilentError) as error:
            return self._recall_axis(axis, error.message)
        except MachineError:
            pass  # a drive in fault still answers
        try:
            self._positions[axis.name] = (self.clock.now_s(), axis.drive.position())
        except MachineError as error:
            return self._recall_axis(axis, error.message)
        return self._recall_axis(axis, "")

    def _recall_axis(self, axis: Axis, why_old: str) -> AxisLocation:
        read_s, position = self._positions.get(axis.name, (None, None))
        age_s = None if read_s is None else self.clock.now_s() - read_s
        referenced = axis.name in self.state.referenced
        return AxisLocation(axis.name, axis.unit, position, age_s, referenced, why_old)

    # The needle

    def reference_axes(self) -> None:
        """Set the present positions of all axes to zero (homing method 35).

        Raises
        ------
        SafetyStopError
            When a needle is or may be in tissue: its depth and roll would be lost.
        DriveError, BusError
        """
        self.needle.refuse_in_tissue("no axis is homed", self.description.option)
        for axis in self.axes:
            self.home(axis.name, Homing(HOMING_HERE))

    def home(self, axis_name: str, homing: Homing) -> None:
        """Home one axis; meanwhile all axes are supervised, and all are stopped if anything goes wrong.

        Raises
        ------
        SafetyStopError
            When a needle is or may be in tissue.
        InterruptedRunError, DriveError, BusError
            The axis then has no reference.
        """
        self.needle.refuse_in_tissue("no axis is homed", self.description.option)
        axis = self._axes[axis_name]
        self.needle.note_reference(axis_name, known=False)
        try:
            for _ in axis.home(homing):
                self.clock.sleep(_HOMING_LOOK_S)
                self.supervise()
        except (InterruptedRunError, MachineError) as error:
            self._stop_because_of(error)
        self.needle.note_reference(axis_name, known=True)

    def check_homing(self, name: str, method: int, *, needle_mounted: bool) -> None:
        """Refuse a homing that is not allowed, or cannot end with the current limit of this opening.

        Raises `SafetyStopError`, `LimitError`.
        """
        self.needle.refuse_in_tissue(f"axis {name} is not homed", self.description.option)
        require_homing_allowed(
            name,
            method,
            self.axis(name).description.homing_direction(method),
            needle_mounted=needle_mounted,
            referenced=self.state.referenced,
        )
        limit_ma = self._max_current_ma(self.axis(name))
        threshold_ma = self.axis(name).description.homing_current_ma(method)
        if threshold_ma is not None and limit_ma is not None and threshold_ma >= limit_ma:
            raise LimitError(
                f"axis {name} would never feel its stop: it is felt at {threshold_ma} mA, and no drive exceeds "
                f"{limit_ma} mA (the lower one of --current-ma and max_current_ma of the rig file)",
                f"--current-ma {threshold_ma + threshold_ma // 2}, or a lower homing.current_threshold_ma",
            )

    def home_axis(self, name: str, method: int, *, needle_mounted: bool) -> None:
        """Home one axis by this method, with the settings of the rig file; the operator has confirmed it.

        Raises
        ------
        SafetyStopError
            When a needle is or may be in tissue, or this homing is not allowed; nothing has moved.
        DriveError, BusError, InterruptedRunError
            The axis has been stopped and has no reference.
        """
        self.check_homing(name, method, needle_mounted=needle_mounted)
        homing = self.axis(name).description.homing
        self.home(name, Homing(method, homing.position, homing.offset, homing.speed, homing.timeout_s))

    def assume_positions(self, positions: Mapping[str, float]) -> None:
        """Assume the positions that a person has confirmed, for axes that have lost their reference [mm or rad].

        Only for withdrawing a needle: the axes stay without a reference, and the next run asks for zero.

        Raises `DriveError`, `BusError`.
        """
        for name, position in positions.items():
            self._axes[name].assume_position(position)

    # Opening and closing

    def connect(self) -> None:
        """Verify, configure and enable every drive; it holds its position, and nothing moves.

        Raises as `verify` and `enable`.
        """
        self.verify()
        self.enable()

    def verify(self) -> None:
        """Verify and configure every drive; power stays off.

        Raises
        ------
        DriveError
            With the failures of all drives, not only the first.
        BusError
        """
        self._watch.listen(self.clock)
        for step in (self._identify, self._offer_fault_reset, self._configure):
            self._do_with_all(step, self._find_shared_cob_ids)
        self._recall_references()

    def enable(self) -> None:
        """Switch power on, unless it is on; each axis holds its position, and is supervised from now on.

        Raises
        ------
        DriveError, BusError, SecondMasterError
        """
        if self._has_power:
            return
        self._watch.require_free()
        self._watch.forget_states()
        limits_ma = {axis.name: self._max_current_ma(axis) for axis in self.axes}
        self._load.get_ready(self.axes, {name: ma for name, ma in limits_ma.items() if ma is not None})
        for axis in self.axes:
            axis.drive.enable()
        self._has_power = self._is_watching = True

    def _do_with_all(
        self, step: Callable[[Axis], None], find_more: Callable[[], list[MachineError]] = list
    ) -> None:
        """Do something with every axis, and raise the failures of all together, with more that are found afterwards."""
        failures: list[MachineError] = []
        for axis in self.axes:
            try:
                step(axis)
            except MachineError as error:
                failures.append(error)
        raise_together([*failures, *find_more()])

    def _identify(self, axis: Axis) -> None:
        self._identities[axis.name] = axis.drive.identify()

    def _configure(self, axis: Axis) -> None:
        limit_ma = self._max_current_ma(axis)
        own_ma = self._restore_current_limit(axis)
        if limit_ma is not None and own_ma is not None and limit_ma < own_ma:
            self.needle.note_current_limit(axis.name, own_ma, limit_ma)
        axis.drive.configure(self.description.can.heartbeat, limit_ma)

    def _restore_current_limit(self, axis: Axis) -> int | None:
        """Return a drive's own current limit [mA]; write it again if a labrig that was killed has left another one."""
        found_ma = axis.drive.current_limit_ma()
        own_ma, left_ma = self._limits_found.get(axis.name, (None, None))
        if own_ma is None or found_ma != left_ma:
            return found_ma
        axis.drive.set_current_limit(own_ma)
        return own_ma

    def _max_current_ma(self, axis: Axis) -> int | None:
        """Return the limit of the output current of an axis while the rig is open; None keeps the drive's own."""
        limits_ma = (axis.description.max_current_ma, self._opening.max_current_ma.get(axis.name))
        return min((limit_ma for limit_ma in limits_ma if limit_ma is not None), default=None)

    def _offer_fault_reset(self, axis: Axis) -> None:
        """Reset the fault of a drive if this opening allows it and the operator confirms; refuse it otherwise."""
        fault = next(iter(axis.drive.faults()), None)
        if fault is None:
            return
        if not self._opening.reset_faults:
            command = "withdraw" if self.state.needle_in_tissue else f"home --axis {axis.name}"
            way_out = f"labrig devices {command} {self.description.option} resets it once you confirm"
            raise fault.reword(fault.message, f"{fault.hint}; {way_out}")
        if not self.ask(ConfirmFaultReset(fault.message, fault.remedy)).confirmed:
            raise fault.reword(f"{fault.message}; the operator did not confirm its reset")
        axis.drive.reset_fault()

    def _find_shared_cob_ids(self) -> list[MachineError]:
        """Return an error for each COB-ID of process data that two drives would both send or both obey.

        A drive that does not answer is left out: it has failed already, or the next step finds it silent.
        """
        owners: dict[tuple[int, int], str] = {}
        failures: list[MachineError] = []
        for axis in self.axes:
            try:
                both_ways = axis.drive.cob_ids()
            except MachineError:
                continue
            for way, cob_ids in enumerate(both_ways):
                for cob_id in sorted(cob_ids):
                    other = owners.setdefault((way, cob_id), axis.name)
                    if other != axis.name:
                        failures.append(_shared_cob_id_error(cob_id, other, axis.name))
        return failures

    def _recall_references(self) -> None:
        """Accept an axis as referenced if both the state file and its drive say so."""
        for axis in self.axes:
            axis.referenced = axis.name in self.state.referenced and axis.drive.is_referenced()
            if axis.referenced:
                axis.drive.set_limits(axis.limits)
        self.needle.forget_references(axis.name for axis in self.axes if not axis.referenced)

    def end(self) -> None:
        """Stop every axis for good: what is done aside from now on only holds them. Raises as `stop` does."""
        self._is_ending = True
        self.stop()

    def close(self) -> None:
        """Stop every axis and switch its power stage off: nothing supervises the drives from now on.

        Raises
        ------
        SafetyStopError
            When an axis may still move or have power.
        """
        self._is_watching = False
        try:
            self.stop()
        finally:
            failures = _try_each(self.axes, lambda axis: axis.drive.close())
            if not failures:
                self.needle.forget_current_limits()
            self._forget_lost_zeros()
        if failures:
            raise SafetyStopError(
                "power not known to be off: " + "; ".join(failures), "press the emergency stop"
            )


def _is_explained(error: MachineError | InterruptedRunError) -> bool:
    """Tell whether an error names a standstill of labrig already."""
    return error.message.startswith((_STOOD_STILL, _SUSPENDED))


def _tell_suspension(gap: Gap) -> str:
    return f"{_SUSPENDED} for {gap.suspended_s:.0f} s, so the drives stopped by themselves"


def _has_lost_drives(error: InterruptedRunError | MachineError) -> bool:
    """Tell whether an error means that drives can no longer be told to stop."""
    return isinstance(error, BusError | DriveSilentError) and not isinstance(error, BusPassiveError)


def _shared_cob_id_error(cob_id: int, first: str, second: str) -> MachineError:
    return DriveError(
        f"the drives of {first} and {second} share the COB-ID 0x{cob_id:03X}",
        "restore the default PDO COB-IDs of each drive with the program of its manufacturer and save them; then, with "
        "no needle in tissue, power it off and on",
    )


def _try_each(axes: tuple[Axis, ...], action: Callable[[Axis], None]) -> list[str]:
    """Do something with every axis; return the messages of the failures."""
    failures = []
    for axis in axes:
        try:
            action(axis)
        except MachineError as error:
            failures.append(error.message)
    return failures


def _ask_device(ask: Callable[[], Mapping[str, object]]) -> Mapping[str, object]:
    """Return the answer of a device, or the reason why there is none."""
    try:
        return ask()
    except MachineError as error:
        return {"error": error.message}


@contextmanager
def open_rig(
    description: RigDescription,
    *,
    seed: int,
    person: Operator,
    interrupted: Interrupted,
    insisted: Interrupted | None = None,
    doing: str = "labrig",
    opening: Opening = WHOLE,
    alert: Callable[[str], None] = lambda _text: None,
) -> Iterator[Rig]:
    """Open a rig, and stop and release it when the block ends in any way.

    Parameters
    ----------
    description : RigDescription
        The rig file.
    seed : int
        For every draw of a simulated world.
    person : Operator
        Answers on a bench, and where one is rehearsed; any other simulated rig answers by itself.
    interrupted : callable
        Returns the name of a signal that has arrived, or None.
    insisted : callable or None
        The same while a device keeps labrig waiting, see `Rig`.
    doing : str
        What the rig is used for; another labrig that wants the rig shows it.
    opening : Opening
        Which parts are opened, and how.
    alert : callable
        Tells the person at the rig at once that the drives are lost.

    Raises
    ------
    InputError
        When the rig file has unknown entries.
    LockedError
        When another labrig uses the rig.
    BusError, DriveError, CameraError
        When the rig cannot be opened; nothing has moved.
    """
    require_complete(description, opening.axes)
    with ExitStack() as stack:
        stop_requests = stack.enter_context(acquire_rig(description, doing))
        hardware = make_hardware(description, seed)
        stack.callback(hardware.close)
        link = hardware.open_link()
        stack.callback(link.close)
        source = hardware.open_source() if opening.camera else None
        if source is not None:
            stack.callback(close_source, source, hardware.camera_worker)
        rig = Rig(
            description,
            hardware=hardware,
            link=link,
            source=source,
            person=hardware.accompany(person),
            interrupted=interrupted,
            insisted=insisted,
            stop_requests=stop_requests,
            opening=opening,
            doing=doing,
            alert=alert,
        )
        stack.push(_close_on_exit(rig))
        rig.verify()
        if opening.power:
            rig.enable()
        yield rig


def _close_on_exit(rig: Rig) -> Callable[[object, BaseException | None, object], None]:
    """Return an exit callback that closes a rig; an error already being raised keeps priority."""

    def close(_kind: object, error: BaseException | None, _traceback: object) -> None:
        try:
            rig.close()
        except SafetyStopError as failure:
            if error is None:
                raise
            error.add_note(failure.message)

    return close
