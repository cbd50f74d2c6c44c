"""The camera with which pictures were taken, and its settings then, as calibrations and test frames keep it."""

from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

CAMERA = "camera"
"""Its key in the provenance of a calibration."""


class CameraInUse(BaseModel):
    """A camera and its settings.

    Attributes
    ----------
    driver, device : str or None
        Its driver and its address, as the rig file has them.
    settings : dict
        Every setting that the camera read back or reported.
    """

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)

    driver: str | None = None
    device: str | None = None
    settings: dict[str, str | int | float]

    @classmethod
    def parse(cls, document: Any) -> "CameraInUse | None":
        """Return the camera of a document; None if it describes none."""
        try:
            return cls.model_validate(document)
        except ValidationError:
            return None


UNKNOWN_CAMERA = CameraInUse(settings={})
"""A camera of which nothing is known."""
