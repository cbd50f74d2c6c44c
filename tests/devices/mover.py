"""A process that moves an axis of a served rig until something ends it: `python -m tests.devices.mover BUS FOLDER`.

BUS is JSON, the arguments of `can.Bus`.
"""

import json
import sys
from pathlib import Path

from tests.devices.bench_rig import bench_description, bench_rig

HEARTBEAT_S = 0.5
SPEED_MM_S, QUICK_STOP_MM_S2 = 4.0, 50.0


def main(bus: str, folder: str) -> None:
    """Move for half a minute, beating."""
    description = bench_description(
        json.loads(bus),
        f"can.heartbeat.timeout_ms={1000 * HEARTBEAT_S:.0f}",
        "can.answer_timeout_ms=5000",
        f"axes.insertion.quick_stop_deceleration={QUICK_STOP_MM_S2}",
    )
    with bench_rig(description, Path(folder)) as rig:
        rig.reference_axes()
        rig.axis("insertion").start_move(119.0, SPEED_MM_S)
        sys.stdout.write("moving\n")
        sys.stdout.flush()
        while True:
            rig.wait(0.1)
            rig.read_states()


if __name__ == "__main__":
    main(*sys.argv[1:])
