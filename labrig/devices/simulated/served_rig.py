"""A whole rig for a rehearsal: its drives on a bus that labrig reaches, and a camera that sees what they move.

The main thread passes frames and moves the shafts. A thread of its own has the world: it takes positions and what a
person does in the order in which they come, and draws the pictures. A slow picture therefore delays no answer of a
drive. Both are of one clock: a picture shows where the shafts were at its time of exposure.
"""

from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from queue import Empty, SimpleQueue

from labrig.clock import Clock
from labrig.devices.clocks import SystemClock
from labrig.devices.fault_script import FaultDescription
from labrig.devices.operator import ClearBench, PlaceSpecimen, ShiftToHole
from labrig.devices.rig_file import RigDescription
from labrig.devices.simulated.faults import FaultScript
from labrig.devices.simulated.local_ports import find_local_ports
from labrig.devices.simulated.operator import SimulatedOperator
from labrig.devices.simulated.picture_stream import PictureStream
from labrig.devices.simulated.plant import SimulatedPlant
from labrig.devices.simulated.serving import BOOT_TIME_S, Gateway, write_journal
from labrig.devices.simulated.slcan_server import SlcanServer
from labrig.devices.simulated.typed_requests import parse_request
from labrig.errors import InputError
from labrig.simulation.description import WorldDescription
from labrig.simulation.world import World

_SAMPLE_S = 0.01
"""Time between two positions that the world is given: 0.05 mm at 5 mm/s."""

_PATIENCE_S = 0.05
"""Longest wait of the world's thread for something to do."""


@dataclass(frozen=True)
class Rehearsal:
    """What is served.

    Parameters
    ----------
    rig : RigDescription
        The rig file with which labrig is going to open this rig.
    world : WorldDescription
        The world that its needle moves in.
    seed : int
        For every draw of the world.
    faults : tuple of FaultDescription
        Faults; their times count from the start.
    """

    rig: RigDescription
    world: WorldDescription
    seed: int = 0
    faults: tuple[FaultDescription, ...] = ()


class SeenWorld:
    """A world in a thread of its own, and the camera before it.

    Parameters
    ----------
    world : World
        The world; from now on only this thread uses it.
    stream : PictureStream
        Takes the pictures.
    clock : Clock
        Tells when the next picture is due.
    rate_hz : float
        Pictures a second, while a program takes them.
    report : callable
        Called from the thread with what was done, or why not.
    """

    def __init__(
        self,
        world: World,
        stream: PictureStream,
        clock: Clock,
        *,
        rate_hz: float,
        report: Callable[[str], None],
    ) -> None:
        self._world = world
        self._stream = stream
        self._clock = clock
        self._period_s = 1 / rate_hz
        self._report = report
        self._specimen = ""
        self._exposed_utc_s = clock.utc().timestamp()
        self._positions: Mapping[str, float] = {"insertion": 0.0, "rotation": 0.0, "linear": 0.0}
        self._operator = SimulatedOperator(world, lambda: self._positions)
        self._inbox: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._is_over = False
        self._thread = ThreadPoolExecutor(1, "labrig world")
        self._life = self._thread.submit(self._live)

    def move(self, utc_s: float, positions: Mapping[str, float]) -> None:
        """Bring the axes to positions [mm or rad], where they are at a time [s since 1970]."""
        self._inbox.put(partial(self._move, utc_s, positions))

    def do(self, line: str) -> None:
        """Do what a person has typed, and report it."""
        self._inbox.put(partial(self._do, line))

    def check(self) -> None:
        """Raise the error that has ended the thread, if one has."""
        if self._life.done():
            self._life.result()

    def close(self) -> None:
        """End the thread."""
        self._is_over = True
        self._thread.shutdown()

    def _live(self) -> None:
        self._draw()  # the first picture of a world takes a second
        next_s = self._clock.now_s()
        while not self._is_over:
            self._take(max(0.0, min(next_s - self._clock.now_s(), _PATIENCE_S)))
            if self._clock.now_s() >= next_s:
                next_s = max(next_s + self._period_s, self._clock.now_s())
                if self._stream.has_clients:
                    self._draw()

    def _take(self, timeout_s: float) -> None:
        """Do everything that has come; wait for the first of it."""
        try:
            self._inbox.get(timeout=timeout_s)()
            while True:
                self._inbox.get_nowait()()
        except Empty:
            return

    def _move(self, utc_s: float, positions: Mapping[str, float]) -> None:
        if positions != self._positions:
            self._world.advance(positions["insertion"], positions["rotation"], positions["linear"])
        self._exposed_utc_s, self._positions = utc_s, positions

    def _draw(self) -> None:
        """Show the world at the time of the last positions, however long the drawing takes."""
        self._stream.show(self._world.picture(), self._exposed_utc_s)

    def _do(self, line: str) -> None:
        try:
            request = parse_request(line)
            if isinstance(request, ShiftToHole):
                request = self._name_specimen(request)
            answer = self._operator.ask(request, lambda: None)
            if isinstance(request, PlaceSpecimen | ClearBench):
                self._specimen = request.name if isinstance(request, PlaceSpecimen) else ""
        except InputError as error:
            self._report(f"not done: {error.message} ({error.hint})" if error.hint else error.message)
            return
        reading = "" if answer.reading is None else f": {answer.reading:.3f}"
        self._report(f"done: {line.strip()}{reading}")

    def _name_specimen(self, request: ShiftToHole) -> ShiftToHole:
        """Return the request with the specimen that is on the bench. Raises `InputError` if there is none."""
        if not self._specimen:
            raise InputError("no specimen is on the bench", "place one first: specimen NAME PERCENT")
        return replace(request, specimen=self._specimen)


class ServedRig:
    """The drives of a rig with their mechanics and faults, coupled to a world.

    Parameters
    ----------
    rehearsal : Rehearsal
        What is served.
    bus : SlcanServer
        Its bus; the caller closes it.
    stream : PictureStream
        Its camera; the caller closes it.
    report : callable
        Called with what was done by hand, or why not.
    """

    def __init__(
        self, rehearsal: Rehearsal, bus: SlcanServer, stream: PictureStream, report: Callable[[str], None]
    ) -> None:
        self._clock = SystemClock()
        self._bus = bus
        self._gateway = Gateway(bus)
        wire, rig = self._gateway.wire, rehearsal.rig
        world = World(rehearsal.world, rehearsal.seed)
        # This thread reads forces of the world, and changes nothing there.
        self._plant = SimulatedPlant(rig, wire, self._clock, boot_time_s=BOOT_TIME_S, forces=world)
        self.drives = self._plant.drives.values()
        self._faults = FaultScript(wire, self._plant.drives, self._clock, rehearsal.faults)
        self._sampled_s = 0.0
        self._world = SeenWorld(
            world,
            stream,
            self._clock,
            rate_hz=rig.camera.rate_hz,
            report=report,
        )

    def serve(self, until: Callable[[], object], typed: Callable[[], Iterable[str]]) -> None:
        """Serve until `until` returns something true; do what `typed` returns, a line each. Raises `BusError`."""

        def tick() -> None:
            self._tick()
            for line in typed():
                self._world.do(line)

        self._gateway.serve(self.drives, until, tick)

    def close(self) -> None:
        """End the world's thread."""
        self._world.close()

    def _tick(self) -> None:
        self._faults.tick()
        if self._gateway.wire.is_unplugged:
            self._bus.unplug()
        self._world.check()
        now_s = self._clock.now_s()
        if now_s - self._sampled_s >= _SAMPLE_S:
            self._sampled_s = now_s
            self._world.move(self._clock.utc().timestamp(), self._plant.true_positions())


def serve_rig(
    rehearsal: Rehearsal,
    *,
    until: Callable[[], object],
    ready: Callable[[], None],
    typed: Callable[[], Iterable[str]],
    report: Callable[[str], None],
    journal: Path | None = None,
) -> None:
    """Serve a rig until `until` returns something true.

    Parameters
    ----------
    rehearsal : Rehearsal
        What is served.
    until : callable
        Called some hundred times a second.
    ready : callable
        Called once labrig can open the rig.
    typed : callable
        Returns the lines that a person has typed since its last call: what they do by hand.
    report : callable
        Called with what was done by hand, or why not.
    journal : Path or None
        File for the events of the drives, written at the end.

    Raises
    ------
    InputError
        When the rig file cannot be served, or its camera does not fit the world.
    BusError, CameraError
        When a port is in use.
    DiskError
        When the journal cannot be written.
    """
    rig = rehearsal.rig
    ports = find_local_ports(rig)
    _require_fitting_lens(rig, rehearsal.world)
    with (
        SlcanServer(ports.can, rig.can.bitrate) as bus,
        closing(PictureStream(ports.camera)) as stream,
        closing(ServedRig(rehearsal, bus, stream, report)) as served,
    ):
        ready()
        try:
            served.serve(until, typed)
        finally:
            if journal is not None:
                write_journal(journal, served.drives)


def _require_fitting_lens(rig: RigDescription, world: WorldDescription) -> None:
    camera, lens = rig.camera, world.lens
    if (camera.width_px, camera.height_px) != (lens.width_px, lens.height_px):
        raise InputError(
            f"the camera of rig {rig.name} is set to {camera.width_px}x{camera.height_px} px, the world's lens draws "
            f"{lens.width_px}x{lens.height_px} px",
            "write the same size for both: camera.width_px and height_px, and lens in the section world",
        )
