"""What the experiment needs of a rig, and how it runs on one."""

from dataclasses import dataclass

from labrig.devices.operator import OperatorRequest
from labrig.devices.rig_file import RigDescription
from labrig.runner.experiment import PlannedMove, RunPlan, total_duration_s
from labrig.runner.graph_paper import confirm_needle_out
from labrig.runner.plan import find_move_problems
from labrig.runner.session import Session
from labrig_example.repeatability.events import Role, VisitStart, VisitStop
from labrig_example.repeatability.protocol import RepeatabilityProtocol


@dataclass(frozen=True)
class AttachMarker(OperatorRequest):
    """Attach the marker."""

    sentence = (
        "Attach the marker to the {axis} axis. Confirm that no needle is mounted and that the axes stand at zero: "
        "their positions become zero here."
    )

    axis: str


def plan(protocol: RepeatabilityProtocol, rig: RigDescription) -> RunPlan:
    """Return what the protocol needs of a rig."""
    far_mm, speed_mm_s = protocol.far_mm, protocol.speed_mm_s
    moves = (
        PlannedMove("far_mm", "linear", 0.0, far_mm, speed_mm_s),
        PlannedMove("speed_mm_s", "linear", far_mm, 0.0, speed_mm_s),
    )
    return RunPlan(
        trials=protocol.visits,
        duration_s=protocol.visits * total_duration_s(moves),
        pictures=protocol.visits,
        operator_steps=1,
        problems=find_move_problems(protocol, rig, moves),
    )


def run(protocol: RepeatabilityProtocol, session: Session) -> None:
    """Move away and back, and take a picture each time."""
    confirm_needle_out(session)
    session.ask(AttachMarker("linear"))
    session.reference_axes()
    there_and_back_s = 2 * protocol.far_mm / protocol.speed_mm_s
    for visit in range(protocol.visits):
        session.progress(visit * there_and_back_s, f"visit {visit + 1} of {protocol.visits}")
        session.record(VisitStart(trial=visit, far_mm=protocol.far_mm))
        session.move("linear", protocol.far_mm, protocol.speed_mm_s)
        session.move("linear", 0.0, protocol.speed_mm_s)
        frame = session.take_picture(Role.MARKER, visit).frame
        session.record(VisitStop(trial=visit, exit_status="success", final_frame=frame))
    session.progress(protocol.visits * there_and_back_s, "all visits done")
