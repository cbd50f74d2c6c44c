"""One cell of the fault matrix: a run on the simulated rig, a fault in the middle of it, and what came of it."""

import math
import os
import resource
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import can

from labrig import errors
from labrig.cli.signals import SignalNote
from labrig.cli.terminal_operator import TerminalOperator
from labrig.devices.axis_description import AxisDescription
from labrig.devices.camera import Exposure, PictureSource
from labrig.devices.drives import objects as co
from labrig.devices.drives.drive import Homing
from labrig.devices.drives.eds import read_own_eds
from labrig.devices.drives.generic import Cia402Axis
from labrig.devices.drives.objects import Place
from labrig.devices.drives.states import DriveState
from labrig.devices.fault_script import FaultDescription
from labrig.devices.needle_location import NeedleLocation
from labrig.devices.opening import WHOLE, Opening
from labrig.devices.operator import (
    NO_OFFER,
    Answer,
    Offer,
    Operator,
    OperatorRequest,
    PlaceSpecimen,
    ShiftToHole,
)
from labrig.devices.rig import Rig
from labrig.devices.rig_file import RigDescription
from labrig.devices.simulated.bus import InProcessBus
from labrig.devices.simulated.cia402 import SimulatedCia402Drive
from labrig.devices.simulated.hardware import SimulatedHardware
from labrig.devices.simulated.node import NmtState
from labrig.devices.simulated.shaft import Mechanics
from labrig.devices.trapezoid import Profile
from labrig.experiments.declared import find_experiment
from labrig.protocol.sections import ExperimentProtocol
from labrig.record.check import check_run
from labrig.record.reader import Run, open_run
from labrig.runner.conduct import Outcome, conduct, conduct_withdrawal
from labrig.runner.session import Session
from labrig.runner.withdrawal import read_needle_path
from tests.devices import epos2_places as od
from tests.devices.fault_table import (
    EMERGENCIES,
    REFUSED_AT_CONNECT,
    SCENARIOS,
    TOLD_WITHIN_S,
    WITHDRAWN_NEVERTHELESS,
    Lost,
    Phase,
    Stop,
    outcome_of,
)
from tests.devices.rigs import Person, Signal, count_repeats, simulated_rig
from tests.devices.wire_faults import (
    ERROR_PASSIVE,
    abort_next,
    catch_next,
    deafen,
    delay_next,
    duplicate_next,
    ignore_next,
    stop_heartbeat,
)
from tests.runner.sessions import SHORT_WAY, Told, Watched, begin_record, sweep

AXES = ("insertion", "rotation", "linear")
STRUCK = dict.fromkeys(Phase, "insertion") | {Phase.HOMING: "linear"}
"""Which axis the fault strikes."""

REFERENCED = {phase: set(AXES) for phase in Phase} | {Phase.HOMING: {"insertion", "rotation"}}
"""Which axes know where they are at that moment."""

_SHORT = (*SHORT_WAY, "insertion.length_mm=5", "insertion.speed_mm_s=5", "insertion.frame_every_mm=1")
_FINGERPRINT = (20_261_121, 1)
_RIG = (
    "state_file=state.json",
    *(f"axes.{name}.configuration_fingerprint={list(_FINGERPRINT)}" for name in AXES),
    *(f"axes.{name}.limit_switches=[positive]" for name in AXES),
    *(f"axes.{name}.max_current_ma=1500" for name in AXES),
    "axes.insertion.inputs={needle_force: {source: analog-1, unit: N, units_per_volt: 10, limits: [-20, 20]}}",
    "axes.linear.inputs={door: {source: general-A, expected: true}}",
)
_TO_THE_LOWER_STOP = Homing(method=-4, offset=7.0, speed=5.0, timeout_s=30.0)
_WAY_MM, _QUADCOUNTS_PER_MM = 2.0, {"insertion": 4000, "linear": 1600}
_PERSON_TAKES_S, _HANG_S, _LONG_AFTER_S = 2.0, 3.0, 5.0
_LOOK_S, _OUT_COUNTS = 0.05, 40
_LOCATED_MM = 0.05


class FaultyCamera:
    """Passes everything on to a camera until it is lost or frozen."""

    def __init__(self, source: PictureSource) -> None:
        self.lost = self.frozen = False
        self._source = source
        self._picture: Exposure | None = None
        self.set, self.get, self.close = source.set, source.get, source.close

    def read(self) -> Exposure | None:
        """Return a picture, none, or the last one again."""
        if self.lost:
            return None
        if self._picture is None or not self.frozen:
            self._picture = self._source.read()
        return self._picture


class Hanging(Signal):
    """The place between two transactions where a signal is looked for, and where the program can hang."""

    def __init__(self, hardware: SimulatedHardware) -> None:
        super().__init__()
        self.hangs_s = 0.0
        self._hardware = hardware

    def __call__(self) -> str | None:
        """Hang if it is time to, then return the signal that has arrived."""
        hangs_s, self.hangs_s = self.hangs_s, 0.0
        self._hardware.clock.sleep(hangs_s)
        return self.name


@dataclass
class Cell:
    """A rig in the middle of a run, and what can be done to it."""

    fault: str
    phase: Phase
    hardware: SimulatedHardware
    camera: FaultyCamera
    signal: Hanging
    rig: Rig
    struck_s: float | None = None
    limit: tuple[int, int] | None = None
    alerts: list[tuple[float, str]] = field(default_factory=list)
    located: NeedleLocation | None = None
    taps: list[InProcessBus] = field(default_factory=list)
    moving: list[SimulatedCia402Drive] = field(default_factory=list)
    folder: Path = Path()
    terminal_is_open: bool = True

    @property
    def drive(self) -> SimulatedCia402Drive:
        """The drive that is struck."""
        return self.hardware.drives[STRUCK[self.phase]]

    def script(self, fault: FaultDescription) -> None:
        """Let a fault happen as a rig file does."""
        of_drive = {"axis": STRUCK[self.phase]} if fault.axis else {}
        self.hardware.faults.inject(fault.model_copy(update=of_drive))

    def strike(self) -> None:
        """Let the fault happen, once."""
        if self.struck_s is None:
            self.struck_s = self.hardware.clock.now_s()
            self.moving = [drive for drive in self.hardware.drives.values() if drive.is_moving]
            STRIKES[self.fault](self)

    def at_next_answer(self, then: Callable[[], None]) -> None:
        """Call `then` once when the struck drive has answered or reported, so that the next frame is one of those."""

        def hear(message: can.Message) -> None:
            answers = {0x380 + self.drive.node_id, 0x580 + self.drive.node_id}
            if message.arbitration_id in answers and self.taps:
                self.taps.pop().shutdown()
                then()

        self.taps.append(InProcessBus(self.hardware.wire, hear))

    def fall_behind(self) -> None:
        """Let the drive, whose shaft no longer turns, bear no following error: no current shows before it fails."""
        self.drive.objects.values[co.MAX_FOLLOWING_ERROR] = 0
        self.drive.shaft.jam()

    def shift_counter(self, counts: float) -> None:
        """Let position and demand jump, and the shaft go on as before: an encoder that counts wrong."""
        shaft, profile = self.drive.shaft, self.drive.shaft.profile
        segments = tuple(replace(each, position=each.position + counts) for each in profile.segments)
        shaft.profile = Profile(segments, profile.end_s, profile.end_position + counts)
        shaft.zero -= counts
        shaft.tick(self.hardware.clock.now_s())
        self.drive._target += counts

    def add_twin(self) -> None:
        """Put another drive with the same node id on the bus."""
        SimulatedCia402Drive(self.drive.section, self.hardware.wire, self.hardware.clock, Mechanics())

    def swap(self, entry: Place, value: int) -> None:
        """Put another drive in place of this one, which shows in one of its objects."""
        self.drive.objects.set_fixed(entry, value)
        self.drive.restart()

    def change_parameter(self) -> None:
        """Change a parameter in EPOS Studio, store it, and switch the drive off and on."""
        objects = self.drive.objects
        objects.set_fixed(od.CURRENT_LIMIT, 1234)
        for place in od.CONFIGURATION:
            objects.set_fixed(place, 0)
        self.drive.restart()

    def fill_disk(self) -> None:
        """Let no file of this process grow beyond the longest of the record."""
        self.limit = resource.getrlimit(resource.RLIMIT_FSIZE)
        longest = max(file.stat().st_size for file in self.folder.glob("[a-z]*.*"))
        resource.setrlimit(resource.RLIMIT_FSIZE, (longest, self.limit[1]))

    def free_disk(self) -> None:
        """Let files grow again."""
        if self.limit is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, self.limit)

    def send(self, *frames: tuple[int, bytes]) -> None:
        """Send frames as another program on the bus does."""
        master = InProcessBus(self.hardware.wire, lambda _message: None)
        for can_id, data in frames:
            master.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))
        master.shutdown()

    def write(self, axis: str, *values: tuple[Place, int]) -> None:
        """Write objects of an axis' drive by SDO, as another program on the bus does."""
        for place, value in values:
            data = _OBJECTS[place].encode_raw(value)
            head = struct.pack("<BHB", 0x23 | (4 - len(data)) << 2, *place)
            self.send((0x600 + self.hardware.drives[axis].node_id, head + data.ljust(4, b"\0")))

    def put(self, axis: str, *values: tuple[Place, int]) -> None:
        """Change objects inside a drive: no frame tells of it."""
        for entry, value in values:
            self.hardware.drives[axis].objects.put(entry, value)


_OBJECTS = read_own_eds("epos2.eds").objects
_START = ((co.CONTROLWORD, 0x0F), (co.CONTROLWORD, 0x3F))
_HOME_HERE = ((co.HOMING_METHOD, 35), (co.MODE, 6), (co.CONTROLWORD, 0x0F), (co.CONTROLWORD, 0x1F))


def _sent(can_id: int, data: str) -> Callable[[Cell], None]:
    return lambda cell: cell.send((can_id, bytes.fromhex(data)))


def _change_target(cell: Cell) -> None:
    """Change the target inside the drive; an axis that moves goes there."""
    cell.put("insertion", (co.TARGET_POSITION, 240_000), *(_START if cell.drive.is_moving else ()))


def _creep(cell: Cell) -> None:
    """Move the idle linear axis inside its drive, and leave the target there as it was."""
    target = cell.hardware.drives["linear"].objects.value(co.TARGET_POSITION)
    there = (co.TARGET_POSITION, target + 4000)
    cell.put("linear", there, *_START, (co.CONTROLWORD, 0x0F), (co.TARGET_POSITION, target))


def _hang(duration_s: float) -> Callable[[Cell], None]:
    return lambda cell: setattr(cell.signal, "hangs_s", duration_s)


def _silence_all(cell: Cell) -> None:
    for axis in AXES:
        cell.hardware.faults.inject(FaultDescription.model_validate({"fault": "silent", "axis": axis}))


def _script_fault(**values: object) -> Callable[[Cell], None]:
    return lambda cell: cell.script(FaultDescription.model_validate(values))


def _of_a_question(strike: Callable[[Cell], None]) -> Callable[[Cell], None]:
    return lambda cell: cell.at_next_answer(lambda: strike(cell))


def _emergency(code: int) -> Callable[[Cell], None]:
    return _script_fault(fault="emergency", axis="insertion", code=code)


def _limit_behind(cell: Cell) -> None:
    """Let the axis find itself beyond a software limit that somebody else has written."""
    cell.drive.objects.put(co.LOWER_LIMIT, 2**30)


STRIKES: dict[str, Callable[[Cell], None]] = {
    "one frame duplicated": _of_a_question(lambda cell: duplicate_next(cell.hardware.wire)),
    "one frame lost": _of_a_question(lambda cell: catch_next(cell.hardware.wire)),
    "one answer lost": lambda cell: ignore_next(cell.hardware.wire, cell.drive),
    "one frame late": _of_a_question(
        lambda cell: delay_next(cell.hardware.wire, cell.hardware.clock, 1, 0.2)
    ),
    "node silent": _script_fault(fault="silent", axis="insertion"),
    "node deaf": lambda cell: deafen(cell.drive),
    "boot-up": _script_fault(fault="boot-up", axis="insertion"),
    "SDO abort": lambda cell: abort_next(cell.hardware.wire, cell.drive, 0x08000022),
    "SDO timeout": lambda cell: ignore_next(cell.hardware.wire, cell.drive, 2),
    "heartbeat of the drive lost": lambda cell: stop_heartbeat(cell.hardware.wire, cell.drive),
    "node-id clash": lambda cell: cell.add_twin(),
    **{f"EMCY {name}": _emergency(code) for name, (code, _) in EMERGENCIES.items()},
    "following error": lambda cell: cell.fall_behind(),
    "software limit": _limit_behind,
    "limit switch": lambda cell: cell.drive.set_input("positive-limit", 1.0),
    "emergency stop": _script_fault(fault="emergency-stop", axis="insertion"),
    "bus off": _script_fault(fault="bus-off"),
    "bus passive": lambda cell: cell.hardware.wire.report(*ERROR_PASSIVE),
    "adapter unplugged": _script_fault(fault="unplugged"),
    "wrong encoder resolution": lambda cell: cell.swap(od.ENCODER_PULSES, 1000),
    "wrong vendor": lambda cell: cell.swap(co.VENDOR_ID, 0x2A),
    "unknown hardware": lambda cell: cell.swap(co.PRODUCT_CODE, 0x65520000),
    "fingerprint mismatch": lambda cell: cell.change_parameter(),
    "computer hangs": _hang(_HANG_S),
    "signal": lambda cell: setattr(cell.signal, "name", "SIGINT"),
    "camera lost": lambda cell: setattr(cell.camera, "lost", True),
    "camera frozen": lambda cell: setattr(cell.camera, "frozen", True),
    "disk full": lambda cell: cell.fill_disk(),
    "second master retargets": lambda cell: cell.write("insertion", (co.TARGET_POSITION, 240_000), *_START),
    "second master retargets by process data": _sent(0x401, "3F0080A90300"),
    "second master moves an idle axis": lambda cell: cell.write(
        "linear", (co.TARGET_POSITION, 64_000), *_START
    ),
    "second master writes a setting": lambda cell: cell.write("rotation", (co.MAX_FOLLOWING_ERROR, 2**31)),
    "second master takes the dead-man away": lambda cell: cell.write("insertion", (co.ABORT_CONNECTION, 0)),
    "second master homes": lambda cell: cell.write("insertion", *_HOME_HERE),
    "second master takes power away": _sent(0x201, "0000"),
    "second master resets": _sent(0x000, "8101"),
    "second master resets the communication": _sent(0x000, "8200"),
    "second master makes nodes pre-operational": _sent(0x000, "8000"),
    "second master stops a node": _sent(0x000, "0201"),
    "second master beats": _sent(0x77F, "05"),
    "another client reads": _sent(0x601, "4041600000000000"),
    "all nodes silent": _silence_all,
    "labrig stopped for 0.3 s": _hang(0.3),
    "labrig stopped for 0.8 s": _hang(0.8),
    "terminal closes": lambda cell: setattr(cell.signal, "name", "SIGHUP"),
    "terminal gone stale": lambda cell: setattr(cell, "terminal_is_open", False),
    "target changed in the drive": _change_target,
    "idle axis moved": _creep,
    "encoder jumps": lambda cell: cell.shift_counter(24_000),
    "stall in gel": _script_fault(fault="blocked", axis="insertion"),
    "force limit exceeded": lambda cell: cell.hardware.drives["insertion"].set_input("analog-1", 2500.0),
    "door opened": lambda cell: cell.hardware.drives["linear"].set_input("general-A", 0.0),
    "node becomes pre-operational": lambda cell: setattr(cell.drive, "nmt_state", NmtState.PRE_OPERATIONAL),
}
"""How each fault of the table is made to happen."""


@dataclass(frozen=True)
class CellResult:
    """What came of a cell: how the run ended, when the axes stood still, and what differs from the table."""

    outcome: Outcome
    run: Run
    still_after_s: float
    differences: tuple[str, ...]


@contextmanager
def _rig(
    description: RigDescription, hardware: SimulatedHardware, opening: Opening = WHOLE
) -> Iterator[tuple[Rig, FaultyCamera, Hanging]]:
    link, camera, signal = hardware.open_link(), FaultyCamera(hardware.open_source()), Hanging(hardware)
    rig = Rig(
        description, hardware=hardware, link=link, source=camera, person=Person(), interrupted=signal,
        opening=opening,
    )  # fmt: skip
    yield rig, camera, signal
    with suppress(errors.SafetyStopError):
        rig.close()
    link.close()


def _hardware(description: RigDescription) -> SimulatedHardware:
    """Return a rig whose drives have their fingerprint stored."""
    assert description.world is not None
    hardware = SimulatedHardware(description, description.world, seed=1)
    for drive in hardware.drives.values():
        objects = drive.objects
        for place, value in zip(od.CONFIGURATION, _FINGERPRINT, strict=True):
            objects.set_fixed(place, value)
    return hardware


def epos2_rig() -> RigDescription:
    """Return the rig of the matrix, whose drives are EPOS2."""
    return simulated_rig(*_RIG)


def cia402_rig() -> RigDescription:
    """Return the same rig with drives that only their EDS file describes."""
    rig = simulated_rig(_RIG[0], *(f"axes.{name}.max_current_ma=1500" for name in AXES))
    common = {*AxisDescription.model_fields} - {"driver", "homing"}
    axes = {
        name: Cia402Axis.model_validate(
            dict(Cia402Axis.factory_settings) | {key: getattr(axis, key) for key in common}
        )
        for name, axis in rig.axes.items()
    }
    return rig.model_copy(update={"axes": rig.axes.model_copy(update=axes)})


def run_cell(
    folder: Path, fault: str, phase: Phase, make_rig: Callable[[], RigDescription] = epos2_rig
) -> CellResult:
    """Run a cell on a rig and compare it with the table; record and state file of the rig are in the folder."""
    description = make_rig().placed_in(folder)
    hardware, protocol = _hardware(description), sweep(*_SHORT)
    with _rig(description, hardware) as (rig, camera, signal):
        cell = Cell(fault, phase, hardware, camera, signal, rig)
        rig.needle.mark_out()
        rig.connect()
        rig._alert = lambda text: cell.alerts.append((hardware.clock.now_s(), text))
        outcome, run = _conduct(cell, folder, protocol)
        cell.located = rig.locate_needle()
        counted = sum(count_repeats(axis.drive) for axis in rig.axes)
    hardware.clock.sleep(_LONG_AFTER_S)
    still_after_s = _still_after_s(cell)
    differences = [
        *_ending_differences(cell, outcome, run, counted), *_told_differences(cell, outcome),
        *_stop_differences(cell, still_after_s), *_next_run_differences(cell, description, run.path.name),
    ]  # fmt: skip
    hardware.close()
    return CellResult(outcome, run, still_after_s, tuple(differences))


def _conduct(cell: Cell, folder: Path, protocol: ExperimentProtocol) -> tuple[Outcome, Run]:
    recorder = begin_record(folder, protocol, cell.rig)
    cell.folder = recorder.path
    cell.rig.operator = _Slow(
        cell, Watched(cell.rig.operator, then=lambda request: _meanwhile(cell, request))
    )
    cell.hardware.clock.on_advance(lambda: _strike_on_the_way(cell))
    try:
        outcome = conduct(find_experiment(protocol.experiment), protocol, Session(cell.rig, recorder, Told()))
    finally:
        cell.free_disk()
    return outcome, open_run(recorder.path)


@dataclass(frozen=True)
class _Slow:
    """A person who takes a while to answer one question; what strikes strikes meanwhile."""

    cell: Cell
    operator: Operator

    def ask(self, request: OperatorRequest, meanwhile: Callable[[], None], offer: Offer = NO_OFFER) -> Answer:
        """Answer, after a while in which the rig looks after its axes."""
        if self.cell.phase is Phase.ASKING and isinstance(request, ShiftToHole):
            self.cell.strike()
            for _ in range(round(_PERSON_TAKES_S / _LOOK_S)):
                if not self.cell.terminal_is_open:
                    return self._ask_at_closed_terminal(request)
                self.cell.hardware.clock.sleep(_LOOK_S)
                meanwhile()
        return self.operator.ask(request, meanwhile)

    def _ask_at_closed_terminal(self, request: OperatorRequest) -> Answer:
        keyboard, screen = os.openpty()
        with os.fdopen(screen, encoding="utf-8") as terminal:
            return TerminalOperator(SignalNote(), terminal).ask(request, lambda: os.close(keyboard))


def _meanwhile(cell: Cell, request: OperatorRequest) -> None:
    """Do what the person at the bench does, or the fault that strikes meanwhile."""
    if cell.phase is Phase.HOMING and isinstance(request, PlaceSpecimen):
        cell.rig.home("linear", _TO_THE_LOWER_STOP)
    if cell.phase is Phase.IDLE and isinstance(request, ShiftToHole):
        cell.strike()
        cell.rig.wait(_PERSON_TAKES_S)


def _strike_on_the_way(cell: Cell) -> None:
    """Strike once the axis has gone a part of its way."""
    if cell.phase in {Phase.IDLE, Phase.ASKING}:
        return
    doing = cell.drive.is_homing if cell.phase is Phase.HOMING else cell.drive.is_moving
    if doing and abs(cell.drive.shaft_counts) / _QUADCOUNTS_PER_MM[STRUCK[cell.phase]] >= _WAY_MM:
        cell.strike()


def _still_after_s(cell: Cell) -> float:
    """Return how long after the strike the axis that moved came to rest, in the drive's own time; 0 if none moved.

    Somebody else may set an axis moving that stood: then every axis counts.
    """
    assert cell.struck_s is not None, "the fault never struck"
    counted = cell.hardware.drives.values() if cell.fault in SCENARIOS else cell.moving
    return max([0.0, *(drive.shaft.still_s - cell.struck_s for drive in counted)])


def _ending_differences(cell: Cell, outcome: Outcome, run: Run, counted: int) -> Iterator[str]:
    expected = outcome_of(cell.fault, cell.phase)
    if outcome.exit_status != expected.ends or run.manifest["exit_status"] != expected.ends:
        yield f"ended {outcome.exit_status} ({outcome.reason}), record {run.manifest['exit_status']}"
    if type(outcome.error) is not (expected.error or type(None)):
        yield f"error {type(outcome.error).__name__}: {outcome.reason}"
    fault = outcome.error.fault if isinstance(outcome.error, errors.WireError) else None
    if (None if fault is None else (fault.name, fault.code)) != expected.fault:
        yield f"fault {fault}"
    if run.events.iloc[-1].get("fault", None) != (None if fault is None else asdict(fault)):
        yield f"the last event says {run.events.iloc[-1].get('fault')}"
    if expected.words not in str(run.manifest["reason"]):
        yield f"reason {run.manifest['reason']}"
    if run.damage or run.events.empty or list(run.events["kind"])[-1] != "run_stop":
        yield f"record: {run.damage}"
    if expected.counted and not counted:
        yield "not counted"
    checked = check_run(run.path)
    if checked.damage or checked.notices:
        yield f"runs check: {(*checked.damage, *checked.notices)}"


def _told_differences(cell: Cell, outcome: Outcome) -> Iterator[str]:
    """Yield what the person at the rig is told late or wrongly: lost drives, and where the needle is."""
    assert cell.struck_s is not None
    assert cell.located is not None
    lost = isinstance(outcome.error, errors.BusError | errors.DriveSilentError) and not isinstance(
        outcome.error, errors.BusPassiveError
    )
    found_s = cell.alerts[0][0] - cell.struck_s if cell.alerts else math.inf
    if lost != bool(cell.alerts) or (lost and _is_found_out_at_once(cell) and found_s > TOLD_WITHIN_S):
        yield f"told after {found_s:.2f} s: {cell.alerts}"
    if lost and "press the emergency stop" not in cell.alerts[0][1]:
        yield f"told {cell.alerts[0][1]}"
    for axis in cell.located.axes:
        truly_mm = cell.hardware.drives[axis.axis].shaft_counts / _QUADCOUNTS_PER_MM.get(axis.axis, 1)
        is_told = (
            axis.position is not None and axis.referenced and not axis.why_old and axis.axis == "insertion"
        )
        if is_told and cell.phase is not Phase.HOMING and abs(axis.position - truly_mm) > _LOCATED_MM:
            yield f"told that {axis} when it is {truly_mm}"


def _is_found_out_at_once(cell: Cell) -> bool:
    """Tell whether labrig asks the drives all the time when the fault strikes."""
    return outcome_of(cell.fault, cell.phase).stop is not Stop.NO_DEADLINE


def _stop_differences(cell: Cell, still_after_s: float) -> Iterator[str]:
    limit = outcome_of(cell.fault, cell.phase).stop.value
    if still_after_s > limit + 1e-6:
        yield f"stood still after {still_after_s:.3f} s, limit {limit:.3f} s"
    stood = [drive.shaft_counts for drive in cell.hardware.drives.values()]
    cell.hardware.clock.sleep(_LONG_AFTER_S)
    if [drive.shaft_counts for drive in cell.hardware.drives.values()] != stood:
        yield "moves on"


def _mend(cell: Cell) -> set[str]:
    """Mend what has failed, switch off and on what is in fault, and return which axes that were."""
    cell.hardware.wire.restore()
    off_and_on = set()
    for name, drive in cell.hardware.drives.items():
        drive.line.take, drive._is_mute = drive._on_frame, False
        drive.restore_power_stage()
        drive.shaft.free()
        drive.set_input("positive-limit", 0.0)
        if drive._state in {DriveState.FAULT, DriveState.FAULT_REACTION}:
            off_and_on.add(name)
            drive.restart()
    return off_and_on


def _next_run_differences(cell: Cell, description: RigDescription, run_name: str) -> Iterator[str]:
    """Yield what the next run does otherwise than it should: it honours the needle and the lost references."""
    expected = outcome_of(cell.fault, cell.phase)
    _mend(cell)
    if (refused := REFUSED_AT_CONNECT.get(cell.fault)) is not None:
        with _rig(description, cell.hardware) as (rig, _, _):
            try:
                rig.connect()
            except errors.MachineError as error:
                if refused not in error.message:
                    yield f"next run: {error.message}"
            else:
                yield f"next run was not refused for {refused}"
        if cell.fault not in WITHDRAWN_NEVERTHELESS:
            return
    opening = Opening(hold_inputs=cell.fault not in WITHDRAWN_NEVERTHELESS)
    with _rig(description, cell.hardware, opening) as (rig, _, _):
        rig.connect()
        lost = {Lost.NONE: set(), Lost.STRUCK: {STRUCK[cell.phase]}, Lost.ALL: set(AXES)}[expected.lost]
        known = (set(AXES) if expected.stop is Stop.NO_DEADLINE else REFERENCED[cell.phase]) - lost
        if set(rig.state.referenced) != known:
            yield f"next run believes {sorted(rig.state.referenced)}, expected {sorted(known)}"
        yield from _needle_differences(cell, rig, run_name)


def _needle_differences(cell: Cell, rig: Rig, run_name: str) -> Iterator[str]:
    expected = outcome_of(cell.fault, cell.phase)
    in_tissue = expected.ends != "success" and (cell.phase is Phase.MOVING or expected.found_in_tissue)
    if rig.state.needle_in_tissue is not in_tissue:
        yield f"next run believes needle_in_tissue {rig.state.needle_in_tissue}"
    try:
        rig.reference_axes()
    except errors.SafetyStopError as error:
        if not in_tissue or run_name not in error.message:
            yield f"next run: {error.message}"
    else:
        if in_tissue:
            yield "next run homed with the needle in tissue"
    if in_tissue:
        yield from _withdrawal_differences(cell, rig, run_name)


def _withdrawal_differences(cell: Cell, rig: Rig, run_name: str) -> Iterator[str]:
    """Yield what keeps a withdrawal from bringing the needle out; an axis without a reference is believed."""
    rig.needle.mark_in_tissue(run_name)
    path = read_needle_path(open_run(cell.folder))
    recorder = begin_record(cell.folder.parent / "withdrawal", sweep(*_SHORT), rig)
    outcome = conduct_withdrawal(Session(rig, recorder, Told()), run_name, path, path[-1])
    if outcome.exit_status != "success" or rig.state.needle_in_tissue is not False:
        yield f"withdrawal: {outcome.reason}"
    if rig.axis("insertion").referenced and abs(cell.drive.shaft_counts) > _OUT_COUNTS:
        yield f"withdrawal left the needle at {cell.drive.shaft_counts} counts"
