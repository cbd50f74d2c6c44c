"""In real time: how soon the person at the rig is told that every drive has fallen silent, and labrig lets go."""

import tempfile
from collections.abc import Callable
from pathlib import Path
from threading import Timer

from labrig.devices.operator import ClearBench
from labrig.devices.rig import Rig
from labrig.errors import MachineError
from tests.benchmarks.table import print_rows
from tests.devices.bench_rig import bench_description, bench_rig
from tests.devices.fault_table import TOLD_WITHIN_S
from tests.devices.rigs import Waiting
from tests.devices.served import Served, served_drives

_SPEED_MM_S = 5.0


def _move(rig: Rig) -> None:
    rig.insertion.start_move(100.0, _SPEED_MM_S)
    while True:
        rig.wait(rig.state_period_s)
        rig.read_states()


def _idle(rig: Rig) -> None:
    while True:
        rig.wait(0.1)


def _ask(rig: Rig) -> None:
    rig.operator = Waiting(rig.clock)
    rig.ask(ClearBench("it"))


DOING: dict[str, Callable[[Rig], None]] = {"moving": _move, "idle": _idle, "asking": _ask}


def print_table() -> None:
    """Silence three drives on a multicast bus a second after each rig begins."""
    rows = [[name, *_measure(do)] for name, do in DOING.items()]
    print_rows(("axis", "told after s", "limit s", "error after s", "told"), rows)


def _measure(do: Callable[[Rig], None]) -> tuple[str, str, str, str]:
    with served_drives("udp_multicast") as served, tempfile.TemporaryDirectory() as folder:
        with bench_rig(bench_description(served.reached_by), Path(folder)) as rig:
            rig.reference_axes()
            told: list[tuple[float, str]] = []
            rig._alert = lambda text: told.append((rig.clock.now_s(), text))
            struck: list[float] = []

            def strike() -> None:
                struck.append(rig.clock.now_s())
                served.do(lambda: _mute_all(served))

            Timer(1.0, strike).start()
            try:
                do(rig)
            except MachineError:
                ended_s = rig.clock.now_s()
        ((told_s, text),), (struck_s,) = told, struck
    return (
        f"{told_s - struck_s:.2f}",
        f"{TOLD_WITHIN_S:.2f}",
        f"{ended_s - struck_s:.2f}",
        text.split(";")[0],
    )


def _mute_all(served: Served) -> None:
    for drive in served.drives.values():
        drive.mute()
