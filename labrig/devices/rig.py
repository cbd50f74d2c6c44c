"""The opened rig: axes, camera, clock, operator and state; and the rules that hold across them."""

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, replace
from functools import partial
from typing import NoReturn, TypeVar

from labrig.clock import Clock
from labrig.devices.axis import Axis
from labrig.devices.axis_positions import collect_axis_positions
from labrig.devices.bus import CanLink
from labrig.devices.bus_watch import BusWatch
from labrig.devices.camera import Camera, PictureSource, close_source
from labrig.devices.clocks import MAX_STEP_S
from labrig.devices.drives.cia402 import Cia402Drive
from labrig.devices.drives.drive import HERE, DriveReading, Homing, Identity, Setpoint, try_all, wait_for_all
from labrig.devices.exclusive import acquire_rig
from labrig.devices.hardware import Hardware, make_hardware
from labrig.devices.heartbeat import Ended, HeartbeatClock
from labrig.devices.homing import require_homing_allowed
from labrig.devices.needle_location import NeedleLocation, are_drives_lost, locate_axis
from labrig.devices.needle_state import NeedleState, RigState
from labrig.devices.opening import WHOLE, Opening, prepare_drives
from labrig.devices.operator import NO_OFFER, Answer, Offer, Operator, OperatorRequest, Paused
from labrig.devices.rig_calls import Photograph, RigCalls
from labrig.devices.rig_file import RigDescription, require_complete
from labrig.devices.supervisor import Interrupted, Supervisor
from labrig.errors import (
    CameraError,
    DiskError,
    DriveError,
    DriveStrayedError,
    InputError,
    InterruptedRunError,
    LabrigError,
    MachineError,
    SafetyStopError,
    SecondMasterError,
    WireError,
)

_T = TypeVar("_T")

_HOMING_LOOK_S = 0.005

_PROMPT_S = 0.25
"""What is done aside and takes longer is interrupted by signals too, and by requests to stop [s]."""


class Rig(RigCalls):
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
    opening : Opening
        Which parts are opened, and how.
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
        opening: Opening = WHOLE,
        alert: Callable[[str], None] = lambda _text: None,
    ) -> None:
        self.description = description
        self._opening = opening
        self._hardware = hardware
        self._link = link
        self._person = person
        self._interrupted = interrupted
        self._alert = alert
        self.clock: Clock = hardware.clock
        self.operator = hardware.operator or person
        self.state_period_s = 1 / description.recording.state_rate_hz
        self.needle = NeedleState(description.state_path, do=self.do_aside)
        self._identities: dict[str, Identity] = {}
        self._heartbeat = HeartbeatClock(self.clock, link, description.can.heartbeat)
        self._step_s = min(MAX_STEP_S, description.can.heartbeat.period_ms / 1000)
        link = replace(link, attend=self._attend)
        self._axes = {
            name: Axis(name, axis, Cia402Drive(link, axis, name, self._heartbeat), self._heartbeat)
            for name, axis in description.axes.items()
            if name in opening.axes
        }
        self.axes = tuple(self._axes.values())
        self._camera: Camera | None = None
        if source is not None:
            self._camera = Camera(source, description.camera, self._heartbeat, hardware.camera_worker)
        nodes = {axis.description.node_id: axis.name for axis in self.axes}
        self._watch = BusWatch(link, nodes, description.can.heartbeat)
        self._supervisor = Supervisor(self._axes, self._watch, self._heartbeat, interrupted, opening)
        self._unknown_motion = ""
        self._stopped_for: Ended | None = None
        self._is_ending = self._is_stopping = False

    # State

    def axis(self, name: str) -> Axis:
        """Return an axis by its name: insertion, rotation or linear. Raises `InputError` if it is not open."""
        if name not in self._axes:
            raise InputError(f"axis {name} is not open", f"open are: {', '.join(self._axes)}")
        return self._axes[name]

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
            "camera": None if self._camera is None else self._camera.describe(),
            "snapshot": self.snapshot(),
            "state": asdict(self.state),
        }

    def snapshot(self) -> dict[str, object]:
        """Return the present state of the devices, ready for JSON; for one that does not answer, the reason."""
        camera, has_power = self._camera, self._supervisor.has_power
        return {
            "axes": {
                axis.name: _ask_device(partial(axis.snapshot, has_power=has_power)) for axis in self.axes
            },
            "camera": camera and _ask_device(partial(camera.read_settings, self._make_meanwhile())),
            "state": asdict(self.state),
        }

    # Moving

    def read_states(self) -> dict[str, DriveReading]:
        """Read every axis, all at one instant: that of a SYNC.

        Raises
        ------
        DriveError, BusError
            When one of them cannot continue; all that answer have been stopped.
        """
        try:
            return self._supervisor.read()
        except MachineError as error:
            self._stop_because_of(error)

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
        before, before_s = collect_axis_positions(self.read_states()), self._supervisor.last_s
        frame = self.camera.capture(self._make_meanwhile())
        after, after_s = collect_axis_positions(self.read_states()), self._supervisor.last_s
        self.camera.require_new(frame, (after.insertion_mm, after.linear_mm))
        fraction, bound_s = frame.place_between(before_s, after_s)
        positions = before.interpolate_to(after, 0.5 if fraction is None else fraction)
        return Photograph(frame.image, frame.t_s, positions, bound_s, fraction)

    def start_move(self, axis_name: str, position: float, speed: float) -> Setpoint:
        """Start a move of an axis [mm or rad, per s] and return at once.

        Raises
        ------
        LimitError, SafetyStopError
            Before anything is sent.
        DriveError, BusError, SecondMasterError
            The axes have been stopped.
        """
        try:
            return self.axis(axis_name).start_move(position, speed)
        except WireError as error:
            self._stop_because_of(error)

    def wait(self, duration_s: float) -> None:
        """Let rig time pass while axes move, and watch for signals and reports of the drives.

        Raises
        ------
        InterruptedRunError
            When a signal has arrived; the axes have been stopped.
        DriveError
            When a drive has reported a fault or has restarted; the axes have been stopped.
        """
        steps = max(1, math.ceil(duration_s / min(self._step_s, self._supervisor.period_s)))
        try:
            self.supervise()
            for _ in range(steps):
                self.clock.sleep(duration_s / steps)
                self.supervise()
        except (InterruptedRunError, MachineError) as error:
            self._stop_because_of(error)

    def await_reading(self, axis_name: str | None = None, passing: float | None = None) -> None:  # noqa: ARG002
        """Let a period of the recorded states pass. Raises as `wait`."""
        self.wait(self.state_period_s)

    def supervise(self) -> None:
        """Go through everything that is watched, see `supervisor`; `wait` and `ask` do so by themselves.

        Raises `InterruptedRunError`, `SafetyStopError`, `BusError`, `DriveError`.
        """
        self._supervisor.step()

    def _attend(self) -> None:
        """Look between two answers of drives: the beat goes on, and another master ends the exchange.

        Without power, an exchange may take as long as it likes.
        """
        if not self._supervisor.has_power:
            self._heartbeat.note_supervision()
        elif not self._is_stopping:
            self._watch.require_no_command()
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

    def _make_meanwhile(self) -> Callable[[], None]:
        """Return what is to be called again and again while something is done aside that begins now.

        Once the run is ending, the axes only stand still: if anything is wrong then, the beat ends.
        """
        prompt_s = self.clock.now_s() + _PROMPT_S

        def supervise() -> None:
            is_prompt = self._is_ending or self.clock.now_s() <= prompt_s
            self._supervisor.heeded = None if is_prompt else self._interrupted
            try:
                self.supervise()
            except (InterruptedRunError, MachineError) as error:
                if not self._is_ending:
                    self._stop_because_of(error)
                self._heartbeat.silence()
            finally:
                self._supervisor.heeded = self._interrupted

        return supervise

    def ask(
        self, request: OperatorRequest, offer: Offer = NO_OFFER, also: Callable[[], None] = lambda: None
    ) -> Answer:
        """Let the operator do something; meanwhile the axes hold still and are supervised.

        A pause is for the person, also where another operator answers, as on a simulated rig.

        Parameters
        ----------
        request : OperatorRequest
            What is asked.
        offer : Offer
            What a person may choose instead; an operator that is no person chooses nothing.
        also : callable
            Called together with the supervision.

        Raises
        ------
        InterruptedRunError, SafetyStopError, BusError, DriveError
            The axes have been stopped.
        """

        def meanwhile() -> None:
            self.supervise()
            also()

        operator = self._person if isinstance(request, Paused) else self.operator
        try:
            return operator.ask(request, meanwhile, offer)
        except (InterruptedRunError, MachineError) as error:
            self._stop_because_of(error)

    def take_can_frames(self) -> list[tuple[float, int, bytes, str]]:
        """Return the CAN frames since the last call: rig time [s], COB-ID, data, T or R for sent or received."""
        return self._link.network.take_frames()

    def stop(self, *, quick: bool = False) -> None:
        """Stop every axis and verify that each stands still; a failure of one axis does not affect the others.

        Takes at most max_speed / acceleration + 0.5 s, and as long again with a quick stop, which is made at once where
        somebody else moves an axis: it is the shortest, and no set-point but labrig's own ends it.

        Raises
        ------
        SafetyStopError
            When an axis may still move; names each such axis and the reason.
        """
        self._is_stopping = True
        failed = try_all(self.axes, lambda axis: axis.drive.post_stop(quick=quick))
        failed += try_all(self.axes, lambda axis: axis.halt(quick=quick))
        if not failed:
            self._heartbeat.note_supervision()  # every drive answers: none is lost
        moving = wait_for_all({axis.name: axis.wait_until_still() for axis in self.axes}, self._heartbeat)
        failures = [*(failure.message for failure in failed), *moving.values()]
        self._is_stopping = self._is_ending
        self._unknown_motion = "not every axis is known to stand still" if failures else ""
        if failures:
            self._heartbeat.silence()
            raise SafetyStopError(
                "not known to stand still: " + "; ".join(dict.fromkeys(failures)),
                "press the emergency stop, then see labrig devices check",
            )

    def _stop_because_of(self, error: Ended) -> NoReturn:
        """Stop everything and raise the error, with what failed meanwhile. Tell first if drives are lost."""
        if error is self._stopped_for:
            raise error
        explained = self._heartbeat.explain(error)
        if are_drives_lost(error):
            self._heartbeat.note_loss()
            if explained is error:
                axis = error.axis if isinstance(error, DriveError) else ""
                lost = f"the drive of axis {axis} does" if axis else "the drives do"
                last = self._locate_needle(f"{lost} not answer", ask=False)
                self._alert(f"{last.motion}\nlast positions: {last.where}")
        self._is_ending = self._is_stopping = True
        is_foreign = isinstance(error, SecondMasterError | DriveStrayedError)
        for end in (partial(self.stop, quick=is_foreign), self._forget_lost_zeros):
            try:
                end()
            except (SafetyStopError, DiskError) as failure:
                explained = explained.reword(f"{explained.message}; {failure.message}")
        self._stopped_for = explained
        if explained is error:
            raise error
        raise explained from error

    def _forget_lost_zeros(self) -> None:
        """Remember which axes have lost their reference. Raises `DiskError`."""
        self.needle.forget_references(self._supervisor.jumped | self._watch.without_zero)

    def fall_silent(self) -> None:
        """Send no more heartbeats: every drive has to stop by itself."""
        self._heartbeat.silence()

    def locate_needle(self) -> NeedleLocation:
        """Return where the needle is: positions that are read now, also from drives in fault, or else the last ones."""
        return self._locate_needle(self._unknown_motion, ask=True)

    def _locate_needle(self, unknown_motion: str, *, ask: bool) -> NeedleLocation:
        now_s, known = self.clock.now_s(), self.state.referenced
        axes = (locate_axis(axis, now_s, referenced=axis.name in known, ask=ask) for axis in self.axes)
        return NeedleLocation(unknown_motion, self.state, tuple(axes))

    # The needle

    def reference_axes(self) -> None:
        """Set the present positions of all axes to zero (homing method 35).

        Raises
        ------
        SafetyStopError
            When a needle is or may be in tissue: its depth and roll would be lost.
        DriveError, BusError
        """
        for axis in self.axes:
            self.home(axis.name, HERE)

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
        self.needle.forget_references([axis_name])
        try:
            for _ in axis.home(homing):
                self.clock.sleep(_HOMING_LOOK_S)
                self.supervise()
            self.supervise()
        except (InterruptedRunError, MachineError) as error:
            self._stop_because_of(error)
        self.needle.note_reference(axis_name)

    def check_homing(self, name: str, method: int, *, needle_mounted: bool) -> None:
        """Refuse a homing that is not allowed, or cannot end with the current limit of this opening.

        Raises `SafetyStopError`, `LimitError`.
        """
        self.needle.refuse_in_tissue(f"axis {name} is not homed", self.description.option)
        axis = self.axis(name)
        require_homing_allowed(
            axis.description,
            name,
            method,
            needle_mounted=needle_mounted,
            referenced=self.state.referenced,
            limit_ma=self._opening.limit_ma(axis),
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
        self.home(name, self.axis(name).description.homing.model_copy(update={"method": method}))

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
        self._identities = prepare_drives(
            self.axes, self.description, self._opening, self.needle, lambda asked: self.ask(asked).confirmed
        )

    def enable(self) -> None:
        """Switch power on, unless it is on; each axis holds its position, and is supervised from now on.

        Raises
        ------
        DriveError, BusError, SecondMasterError, ForceGuardError
        """
        if self._supervisor.has_power:
            return
        self._supervisor.reset()
        for axis in self.axes:
            axis.drive.enable()
        self._supervisor.has_power = True

    def end(self) -> dict[str, DriveReading]:
        """Stop every axis for good: what is done aside from now on only holds them. Raises as `stop` does.

        Returns where each stands; nothing where a drive does not tell, as in a fault.
        """
        self._is_ending = True
        self.stop()
        with suppress(MachineError):
            return {axis.name: axis.drive.read() for axis in self.axes}
        return {}

    def close(self) -> None:
        """Stop every axis and switch its power stage off: nothing supervises the drives from now on.

        Raises
        ------
        SafetyStopError
            When an axis may still move or have power.
        """
        self._supervisor.has_power = False
        failures = []
        try:
            self.stop()
        except SafetyStopError as error:
            failures.append(error.message)
        powered = [failure.message for failure in try_all(self.axes, lambda axis: axis.drive.close())]
        if powered:
            failures.append(f"power not known to be off: {'; '.join(powered)}")
        else:
            self.needle.forget_current_limits()
        self._forget_lost_zeros()
        if failures:
            raise SafetyStopError("; ".join(failures), "press the emergency stop")


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
        stack.enter_context(acquire_rig(description, doing))
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
            opening=opening,
            alert=alert,
        )
        stack.push(_close_on_exit(rig))
        rig.verify()
        if opening.power:
            rig.enable()
        yield rig


def _close_on_exit(rig: Rig) -> Callable[[object, BaseException | None, object], None]:
    """Return an exit callback that closes a rig; an error already being raised tells of a failure to close too."""

    def close(_kind: object, error: BaseException | None, _traceback: object) -> None:
        try:
            rig.close()
        except SafetyStopError as failure:
            if not isinstance(error, LabrigError):
                raise
            told = (
                error.message if failure.message in error.message else f"{error.message}; {failure.message}"
            )
            raise error.reword(told, f"{failure.hint}; then: {error.hint}") from error

    return close
