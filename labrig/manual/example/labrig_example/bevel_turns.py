"""bevel-turns: the needle goes into gel with its bevel at one roll after another, and pictures show where it ends."""

from typing import Literal

import numpy as np
from pydantic import Field

from labrig.analysis.row_table import MeasuredPicture
from labrig.devices.operator import ConfirmAxesAtZero, MountNeedle, PlaceSpecimen, ShiftToHole
from labrig.experiments import Experiment
from labrig.protocol.model import PositiveMm
from labrig.protocol.sections import Advance, MovingProtocol, Needle, Sheath, Specimen
from labrig.runner.session import Session
from labrig.vision.shaft_tip import measure_shaft_tip

EXPERIMENT = Experiment("bevel-turns", __name__, "Turns of the bevel", reanalysis_keys=())
UNITS = {"tip_y": "mm", "tip_z": "mm", "heading": "deg"}


class Protocol(MovingProtocol):
    """The needle is inserted `turns` times, each time with its bevel turned on by as much."""

    experiment: Literal["bevel-turns"] = Field(description="Which experiment this file describes.")
    needle: Needle = Field(description="The needle of the run.")
    sheath: Sheath = Field(description="The tube that brings the needle into the gel.")
    specimen: Specimen = Field(description="The block of gel.")
    insertion: Advance = Field(description="How fast the needle goes in and comes out.")
    length_mm: PositiveMm = Field(description="How far it goes in [mm].")
    turns: int = Field(ge=1, le=36, description="Insertions, spread over a turn of the bevel.")


def run(protocol: Protocol, session: Session) -> None:
    """Turn the bevel, insert, take a picture, and withdraw."""
    session.ask(MountNeedle(protocol.needle.needle_id))
    session.ask(ConfirmAxesAtZero())
    session.reference_axes()
    session.ask(PlaceSpecimen(protocol.specimen.name, protocol.specimen.gelatin_percent))
    speeds, sheath = protocol.insertion, protocol.sheath
    for trial in session.trials(np.linspace(0.0, 2 * np.pi, protocol.turns, endpoint=False).tolist()):
        with trial:
            session.ask(ShiftToHole(protocol.specimen.name, trial.number, 10.0 * trial.number))
            session.move("rotation", trial.what, session.axis("rotation").max_speed / 2)
            session.move("linear", sheath.depth_mm, sheath.speed_mm_s)
            session.move("insertion", protocol.length_mm, speeds.speed_mm_s)
            session.take_picture()
            session.move("insertion", 0.0, speeds.withdraw_speed_mm_s)
            session.move("linear", 0.0, sheath.speed_mm_s)


def measure(picture: MeasuredPicture, protocol: Protocol) -> dict[str, float]:
    """Return where the needle ends, and how it heads there."""
    needle, sheath = protocol.needle, protocol.sheath
    end = measure_shaft_tip(picture.image, picture.plane, needle.diameter_mm, sheath.diameter_mm)
    return {"tip_y": end.tip_mm[0], "tip_z": end.tip_mm[1], "heading": float(np.degrees(end.heading_rad))}
