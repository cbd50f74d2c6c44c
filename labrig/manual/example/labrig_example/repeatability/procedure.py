"""What the experiment needs of a rig, and how it runs on one."""

from dataclasses import dataclass

from labrig.devices.operator import OperatorRequest
from labrig.runner.graph_paper import confirm_needle_out
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

    brings_gel = False

    axis: str


def run(protocol: RepeatabilityProtocol, session: Session) -> None:
    """Move away and back, and take a picture each time."""
    confirm_needle_out(session)
    session.ask(AttachMarker("linear"))
    session.reference_axes()
    for trial in session.trials(range(protocol.visits), starts_itself=True):
        session.tell(f"visit {trial.number + 1} of {protocol.visits}")
        with trial:
            session.record(VisitStart(trial=trial.number, far_mm=protocol.far_mm))
            session.move("linear", protocol.far_mm, protocol.speed_mm_s)
            session.move("linear", 0.0, protocol.speed_mm_s)
            frame = session.take_picture(Role.MARKER, trial.number).frame
            session.record(VisitStop(trial=trial.number, exit_status="success", final_frame=frame))
