"""The opened rig: axes, camera, clock, operator and state; and the rules that hold across them."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import asdict, dataclass
from functools import partial

from labrig.devices.axis import Axis, AxisReadback
from labrig.devices.axis_description import AXES
from labrig.devices.bus import CanLink
from labrig.devices.camera import Camera, Frame, PictureSource
from labrig.devices.clocks import MAX_STEP_S
from labrig.devices.control import StopRequests, acquire_rig
from labrig.devices.drive import Homing, Identity, open_drive, raise_together, wait_for_all
from labrig.devices.hardware import Hardware, make_hardware
from labrig.devices.heartbeat import HeartbeatClock
from labrig.devices.homing import HOMING_HERE, require_homing_allowed
from labrig.devices.motion_log import MotionLog
from labrig.devices.needle_state import NeedleState, RigState
from labrig.devices.operator import Answer, ConfirmFaultReset, Operator, OperatorRequest
from labrig.devices.past_insertion import PastInsertion
from labrig.devices.rig_file import RigDescription, require_complete
from labrig.errors import (
    CameraError,
    DriveError,
    InputError,
    InterruptedRunError,
    LimitError,
    MachineError,
    SafetyStopError,
)

Interrupted = Callable[[], str | None]
"""Returns the name of a signal that has arrived, or None."""

_SYNC = 0x080
_HOMING_LOOK_S = 0.005


@dataclass(frozen=True)
class Opening:
    """What of a rig is opened, and how.

    Parameters
    ----------
    axes : tuple of str
        The axes; the others need not be there, nor be known in the rig file.
    camera : bool
        Whether the camera is opened too.
    max_current_ma : int or None
        Output current that no drive exceeds while it is open; None leaves their own limits.
    reset_faults : bool
        Whether the operator is asked to have faults reset; otherwise a drive in fault is refused.
    """

    axes: tuple[str, ...] = AXES
    camera: bool = True
    max_current_ma: int | None = None
    reset_faults: bool = False


WHOLE = Opening()
"""The whole rig, as a run has it."""


class Rig:
    """An opened rig; made by `open_rig`.

    Parameters
    ----------
    description : RigDescription
        Its rig file.
    hardware : Hardware
        Clock, operator and what is true.
    link : CanLink
        The bus on which the drives stand.
    source : PictureSource or None
        What draws the camera's pictures; None without the camera.
    person : Operator
        Answers where the hardware does not answer by itself.
    interrupted : callable
        Asked between two bus transactions whether a signal has arrived.
    stop_requests : StopRequests or None
        Where another labrig asks this one to stop.
    opening : Opening
        What of it is opened, and how.
    needle : NeedleState or None
        What the rig must not forget; by default what its state file says.
    doing : str
        What the rig is used for.
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
        stop_requests: StopRequests | None = None,
        opening: Opening = WHOLE,
        needle: NeedleState | None = None,
        doing: str = "labrig",
    ) -> None:
        self.description = description
        self._opening = opening
        self.clock = hardware.clock
        self.operator = hardware.operator or person
        self.needs_person = hardware.operator is None
        self.state_period_s = 1 / description.recording.state_rate_hz
        self._hardware = hardware
        self._interrupted = interrupted
        self._stop_requests = stop_requests
        self.needle = needle or NeedleState(description.state_path)
        self._motions = MotionLog(description.state_path, hardware.clock.utc, doing)
        self._identities: dict[str, Identity] = {}
        self._link = link
        self._heartbeat = HeartbeatClock(self.clock, link, description.can.heartbeat)
        self._axes = {
            name: Axis(name, axis, open_drive(link, axis, name, self._heartbeat), self._heartbeat)
            for name, axis in description.axes.items()
            if name in opening.axes
        }
        self._camera = None if source is None else Camera(source, description.camera, self._heartbeat)
        self._read_s = 0.0

    # What is known

    @property
    def axes(self) -> tuple[Axis, ...]:
        """The axes that are open, all three of them in a run."""
        return tuple(self._axes.values())

    def axis(self, name: str) -> Axis:
        """Return an axis by its name: insertion, rotation or linear. Raises `InputError` where it is not open."""
        if name not in self._axes:
            raise InputError(f"axis {name} is not open", f"open are: {', '.join(self._axes)}")
        return self._axes[name]

    @property
    def insertion(self) -> Axis:
        """The screw that pushes the needle out of the sheath."""
        return self.axis("insertion")

    @property
    def rotation(self) -> Axis:
        """What turns the needle about its axis."""
        return self.axis("rotation")

    @property
    def linear(self) -> Axis:
        """The module that carries the instrument with the sheath."""
        return self.axis("linear")

    @property
    def camera(self) -> Camera:
        """The camera. Raises `CameraError` where the rig was opened without it."""
        if self._camera is None:
            raise CameraError(
                "the rig is open without its camera", "open it with its camera to take pictures"
            )
        return self._camera

    @property
    def state(self) -> RigState:
        """What the rig knows of itself across runs."""
        return self.needle.state

    def truth(self) -> tuple[dict[str, object], ...]:
        """Return what is true of the insertion that the camera shows, one dict; nothing where nobody knows."""
        return () if self.description.camera.recorded else self._hardware.truth()

    def recall(self, insertions: Sequence[PastInsertion]) -> None:
        """Take note of what earlier sessions of this run did to the specimens, once its needle is mounted."""
        self._hardware.recall(insertions)

    def describe(self) -> dict[str, object]:
        """Return what the rig is and how it was found, ready for JSON."""
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
            "state": asdict(self.state),
        }

    def snapshot(self) -> dict[str, object]:
        """Return how the devices stand now, ready for JSON; of one that does not answer, why."""
        camera = self._camera
        return {
            "axes": {axis.name: _ask_device(partial(_read_axis, axis)) for axis in self.axes},
            "camera": None if camera is None else _ask_device(camera.read_settings),
            "state": asdict(self.state),
        }

    def _describe_camera(self, camera: Camera) -> dict[str, object]:
        return {
            "driver": self.description.camera.driver,
            "device": self.description.camera.address,
            **({"recorded_pictures": True} if self.description.camera.recorded else {}),
            "asked": dict(camera.settings.asked),
            "readback": dict(camera.settings.readback),
        }

    # Moving

    def read_states(self) -> dict[str, AxisReadback]:
        """Read every axis, all at one instant: that of a SYNC.

        Raises
        ------
        DriveError, BusError
            When one of them cannot go on; all of them have been stopped then, as far as they answer.
        """
        try:
            for axis in self.axes:
                axis.drive.expect_report()
            self._link.send(_SYNC, b"")
            self._read_s = self.clock.now_s()
            return {name: axis.read() for name, axis in self._axes.items()}
        except MachineError as error:
            self._stop_because_of(error)
            raise

    def take_picture(self) -> tuple[Frame, dict[str, AxisReadback]]:
        """Take a picture, and read where every axis stands; the frame says where it lies since the reading before.

        Raises
        ------
        CameraError
            Also for the same picture, to the last bit, after the needle or the sheath has moved.
        DriveError, BusError
        """
        before_s = self._read_s
        frame = self.camera.capture()
        states = self.read_states()
        self.camera.require_new(frame, (states["insertion"].position, states["linear"].position))
        return frame.between(before_s, self._read_s), states

    def wait(self, duration_s: float) -> None:
        """Let rig time pass while axes move, watching for signals and for what drives report.

        Raises
        ------
        InterruptedRunError
            When a signal has arrived; the axes have been stopped.
        DriveError
            When a drive has reported a fault or has restarted; the axes have been stopped.
        """
        steps = max(1, math.ceil(duration_s / MAX_STEP_S))
        try:
            self.supervise()
            for _ in range(steps):
                self.clock.sleep(duration_s / steps)
                self.supervise()
        except (InterruptedRunError, MachineError) as error:
            self._stop_because_of(error)
            raise

    def supervise(self) -> None:
        """Check bus, drives and signals, and only then tell the drives by a beat that somebody watches.

        To be called more often than the heartbeat's period while nothing else lets rig time pass; waits of
        the rig do it by themselves.

        Raises `InterruptedRunError`, `BusError`, `DriveError`.
        """
        self._check()
        self._heartbeat.beat()

    def ask(self, request: OperatorRequest) -> Answer:
        """Let the operator do something; the axes hold still and are looked after meanwhile.

        Raises
        ------
        InterruptedRunError, SafetyStopError, BusError, DriveError
            The axes have been stopped.
        """
        try:
            return self.operator.ask(request, self.supervise)
        except (InterruptedRunError, MachineError) as error:
            self._stop_because_of(error)
            raise

    def note_motion(self, axis_name: str, what: str) -> AbstractContextManager[None]:
        """Note beside the state file, for as long as the block lasts, that an axis is moved outside of any run.

        Raises
        ------
        DiskError
            Before the block.
        """
        return self._motions.note_motion(self.axis(axis_name), what)

    def take_can_frames(self) -> list[tuple[float, int, bytes, str]]:
        """Return the CAN frames since the last call: rig time [s], COB-ID, data, T or R for sent or received."""
        return self._link.network.take_frames()

    def _check(self) -> None:
        if self._link.trouble is not None:
            raise self._link.trouble
        signal_name = self._interrupted()
        if signal_name is not None:
            raise InterruptedRunError(f"interrupted by {signal_name}")
        if self._stop_requests is not None and self._stop_requests.poll():
            raise SafetyStopError(
                "stopped by labrig devices stop", "find out who stopped it and why, then start again"
            )
        for axis in self.axes:
            axis.drive.check()

    def stop(self) -> None:
        """Stop every axis and see that each stands still; every axis is tried, whatever the others do.

        Within max_speed / acceleration + 0.5 s, and once more that long by quick stop.

        Raises
        ------
        SafetyStopError
            When an axis is not known to stand still; names each and why.
        """
        failures = [
            *_try_each(self.axes, lambda axis: axis.drive.send_stop()),
            *_try_each(self.axes, Axis.halt),
            *self._wait_until_still().values(),
        ]
        if self._stop_requests is not None:
            self._stop_requests.answer(failures)
        if failures:
            self._heartbeat.silence()
            raise SafetyStopError(
                "not known to stand still: " + "; ".join(dict.fromkeys(failures)),
                "press the emergency stop, then see labrig devices check",
            )

    def _wait_until_still(self) -> dict[str, str]:
        return wait_for_all({axis.name: axis.wait_until_still() for axis in self.axes}, self._heartbeat)

    def _stop_because_of(self, error: InterruptedRunError | MachineError) -> None:
        """Stop everything; what cannot be stopped is told together with the error that is on its way."""
        try:
            self.stop()
        except SafetyStopError as failure:
            raise error.reword(f"{error.message}; {failure.message}") from failure

    # The needle

    def reference_axes(self) -> None:
        """Make the positions of all axes zero where they stand (homing method 35).

        Raises
        ------
        SafetyStopError
            When a needle is in tissue or may be: its depth and roll would be lost.
        DriveError, BusError
        """
        self.needle.refuse_in_tissue("no axis is homed")
        for axis in self.axes:
            self.home(axis.name, Homing(HOMING_HERE))

    def home(self, axis_name: str, homing: Homing) -> None:
        """Find home with one axis; all are looked after meanwhile, and all are stopped when anything goes wrong.

        Raises
        ------
        SafetyStopError
            When a needle is in tissue or may be.
        InterruptedRunError, DriveError, BusError
            The axis is without a reference then.
        """
        self.needle.refuse_in_tissue("no axis is homed")
        axis = self._axes[axis_name]
        self.needle.note_reference(axis_name, known=False)
        try:
            axis.start_homing(homing)
            while not axis.drive.has_homed():
                self.clock.sleep(_HOMING_LOOK_S)
                self.supervise()
            axis.finish_homing(homing)
        except (InterruptedRunError, MachineError) as error:
            self._stop_because_of(error)
            raise
        self.needle.note_reference(axis_name, known=True)

    def check_homing(self, name: str, method: int, *, needle_mounted: bool) -> None:
        """Refuse a homing that is not allowed, or cannot end, as the rig is open.

        Raises `SafetyStopError`, `LimitError`.
        """
        self.needle.refuse_in_tissue(f"axis {name} is not homed")
        require_homing_allowed(
            name,
            method,
            self.axis(name).description.homing_direction(method),
            needle_mounted=needle_mounted,
            referenced=self.state.referenced,
        )
        limit_ma = self._opening.max_current_ma
        threshold_ma = self.axis(name).description.homing_current_ma(method)
        if threshold_ma is not None and limit_ma is not None and threshold_ma >= limit_ma:
            raise LimitError(
                f"axis {name} would never feel its stop: it is felt at {threshold_ma} mA, and no drive exceeds "
                f"{limit_ma} mA",
                f"--current-ma {threshold_ma + threshold_ma // 2}, or a lower homing.current_threshold_ma",
            )

    def home_axis(self, name: str, method: int, *, needle_mounted: bool) -> None:
        """Give one axis its reference as the rig file has it, by this method; the operator has confirmed it.

        Raises
        ------
        SafetyStopError
            When a needle is in tissue or may be, or this homing is not allowed; nothing has moved.
        DriveError, BusError, InterruptedRunError
            The axis has been stopped and has no reference.
        """
        self.check_homing(name, method, needle_mounted=needle_mounted)
        homing = self.axis(name).description.homing
        self.home(name, Homing(method, homing.position, homing.offset, homing.speed, homing.timeout_s))

    def assume_positions(self, positions: Mapping[str, float]) -> None:
        """Take axes that have lost their reference to stand where a person has confirmed [mm or rad].

        Only for taking a needle out: the axes stay without a reference, and the next run asks for zero.

        Raises `DriveError`, `BusError`.
        """
        for name, position in positions.items():
            self._axes[name].assume_position(position)

    # Opening and closing

    def connect(self) -> None:
        """Verify, configure and enable every drive, held where it stands; nothing moves.

        Raises
        ------
        DriveError
            With the failures of all drives, not only of the first.
        BusError
        """
        failures: list[MachineError] = []
        for step in (self._identify, self._offer_fault_reset, self._configure):
            for axis in self.axes:
                try:
                    step(axis)
                except MachineError as error:
                    failures.append(error)
            failures += self._find_shared_cob_ids()
            raise_together(failures)
        self._recall_references()
        for axis in self.axes:
            axis.drive.enable()

    def _identify(self, axis: Axis) -> None:
        self._identities[axis.name] = axis.drive.identify()

    def _configure(self, axis: Axis) -> None:
        axis.drive.configure(self.description.can.heartbeat, self._opening.max_current_ma)

    def _offer_fault_reset(self, axis: Axis) -> None:
        """Ask whether the fault of a drive may be reset, where this rig was opened to do so; refuse it elsewhere."""
        fault = next(iter(axis.drive.faults()), None)
        if fault is None:
            return
        if not self._opening.reset_faults:
            command = "withdraw" if self.state.needle_in_tissue else f"home --axis {axis.name}"
            way_out = f"labrig devices {command} --rig FILE resets it once you confirm"
            raise fault.reword(fault.message, f"{fault.hint}; {way_out}")
        if not self.ask(ConfirmFaultReset(fault.message, fault.remedy)).confirmed:
            raise fault.reword(f"{fault.message}; the operator did not confirm its reset")
        axis.drive.reset_fault()

    def _find_shared_cob_ids(self) -> list[MachineError]:
        """Return an error for each COB-ID of process data that two drives would both send or both obey.

        A drive that does not tell is left out: it has failed otherwise, or will be found silent by the next step.
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
        """Believe an axis to be referenced when both the state file and its drive say so."""
        for axis in self.axes:
            axis.referenced = axis.name in self.state.referenced and axis.drive.is_referenced()
            if axis.referenced:
                axis.drive.set_limits(axis.limits)
        self.needle.forget_references(axis.name for axis in self.axes if not axis.referenced)

    def close(self) -> None:
        """Stop every axis and switch its power stage off: nobody watches the drives from now on.

        Raises
        ------
        SafetyStopError
            When an axis is not known to stand still without power.
        """
        try:
            self.stop()
        finally:
            failures = _try_each(self.axes, lambda axis: axis.drive.close())
        if failures:
            raise SafetyStopError(
                "power not known to be off: " + "; ".join(failures), "switch the drives off by hand"
            )


def _shared_cob_id_error(cob_id: int, first: str, second: str) -> MachineError:
    return DriveError(
        f"the drives of {first} and {second} share the COB-ID 0x{cob_id:03X}",
        "restore the default PDO COB-IDs of each drive (0x1011:05) in EPOS Studio, save, power it off and on",
    )


def _try_each(axes: tuple[Axis, ...], action: Callable[[Axis], None]) -> list[str]:
    """Do something to every axis; return what went wrong."""
    failures = []
    for axis in axes:
        try:
            action(axis)
        except MachineError as error:
            failures.append(error.message)
    return failures


def _read_axis(axis: Axis) -> dict[str, object]:
    read = axis.read()
    position = {f"position_{axis.unit}": read.position}
    return {**position, "statusword": read.statusword, "drive_state": read.state.name}


def _ask_device(ask: Callable[[], Mapping[str, object]]) -> Mapping[str, object]:
    """Return what a device answers; why, where it does not."""
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
    doing: str = "labrig",
    opening: Opening = WHOLE,
) -> Iterator[Rig]:
    """Open a rig, and stop and release it however the block is left.

    Parameters
    ----------
    description : RigDescription
        The rig file.
    seed : int
        For every draw of a simulated world.
    person : Operator
        Answers on a bench; a simulated rig answers by itself.
    interrupted : callable
        Returns the name of a signal that has arrived, or None.
    doing : str
        What the rig is used for, as another labrig that wants it is told.
    opening : Opening
        What of it is opened, and how.

    Raises
    ------
    InputError
        When the rig file has unknown entries.
    LockedError
        When another labrig has the rig.
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
            stack.callback(source.close)
        rig = Rig(
            description,
            hardware=hardware,
            link=link,
            source=source,
            person=person,
            interrupted=interrupted,
            stop_requests=stop_requests,
            opening=opening,
            doing=doing,
        )
        stack.push(_close_on_exit(rig))
        rig.connect()
        yield rig


def _close_on_exit(rig: Rig) -> Callable[[object, BaseException | None, object], None]:
    """Return an exit callback that closes a rig; an error that is on its way is the one that is told."""

    def close(_kind: object, error: BaseException | None, _traceback: object) -> None:
        try:
            rig.close()
        except SafetyStopError as failure:
            if error is None:
                raise
            error.add_note(failure.message)

    return close
