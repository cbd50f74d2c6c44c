"""What an insertion lacks on a rig, found before anything moves."""

from collections.abc import Iterator

from labrig.devices.can_description import ONLY_SIMULATED
from labrig.devices.needle_state import RollZero
from labrig.devices.rig_file import RigDescription
from labrig.errors import LimitError, Problem
from labrig.experiments.insertion.aim import find_aim_problems, find_pixel_problems, make_aim
from labrig.experiments.insertion.markers import find_marker_problems
from labrig.experiments.insertion.protocol import InsertionProtocol
from labrig.experiments.shared.holes import find_near_holes
from labrig.runner.session import Session
from labrig.vision.plane import PlaneMap


def find_problems(protocol: InsertionProtocol, session: Session) -> Iterator[Problem]:
    """Yield what an insertion lacks on this rig: travel, what nobody measured, a hole that is clear."""
    rig, known, advance = session.description, session.state.roll_zero, protocol.insertion
    try:
        rig.axes.insertion.check_move("insertion", advance.max_length_mm, advance.speed_mm_s)
    except LimitError as error:
        yield Problem("rig axes.insertion", error.message, error.hint)
    yield from _find_unmeasured(protocol, rig, known)
    specimen, diameter_mm = protocol.specimen, protocol.sheath.diameter_mm
    yield from find_near_holes("specimen", specimen, [specimen.first_hole_mm], diameter_mm, specimen.width_mm)


def find_place_problems(protocol: InsertionProtocol, plane: PlaneMap) -> Iterator[Problem]:
    """Yield stated places that are out of the camera's view or cannot be aimed at, and markers that cannot be told."""
    astray = tuple(find_pixel_problems(protocol, plane))
    yield from astray
    yield from find_marker_problems(protocol, plane)
    if not astray and not any(place.ask for place in protocol.places.values()):
        yield from find_aim_problems(protocol, make_aim(protocol, plane), plane)


def _find_unmeasured(
    protocol: InsertionProtocol, rig: RigDescription, certified: RollZero | None
) -> Iterator[Problem]:
    """Yield what is stated to be exactly 0 and was not measured; in the simulated world alone that may be so.

    A success would rest on it.
    """
    unseen = protocol.out_of_plane
    if rig.kind == ONLY_SIMULATED:
        return
    if unseen.heading_sd_deg_per_root_mm == 0.0:
        yield Problem(
            "out_of_plane.heading_sd_deg_per_root_mm",
            f"0 says that needles on rig {rig.name} never wander out of the plane; only a simulated one does not",
            "state what you measured, or null: as much as in the plane",
        )
    if unseen.lag_sd_deg == 0.0 and not _knows_torsion(protocol, certified):
        yield Problem(
            "out_of_plane.lag_sd_deg",
            f"0 says that the bevel of needle {protocol.needle.needle_id} never lags behind the rotation axis, and its "
            f"torsion was not measured on rig {rig.name}",
            "measure it: torsion: {} under roll_zero:, or labrig run protocols/roll-zero.yaml; or state how far it may "
            "lag (5 to 45 degrees were seen in needles 100 mm deep)",
        )


def _knows_torsion(protocol: InsertionProtocol, certified: RollZero | None) -> bool:
    """Return whether the lag of the bevel is measured before the insertion, and compensated."""
    known = certified is not None and certified.needle_id == protocol.needle.needle_id
    finder = certified if known else protocol.roll_zero
    return protocol.policy.turning == "compensated" and finder is not None and finder.torsion is not None
