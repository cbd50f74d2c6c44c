"""The section `camera` of a rig file with `driver: uvc`."""

from typing import Literal

from pydantic import Field

from labrig.devices.camera_settings import ControlledCameraDescription


class UvcCameraDescription(ControlledCameraDescription):
    """A USB camera; what it has none of is null."""

    driver: Literal["uvc"] = Field(description="uvc: a USB camera.")
