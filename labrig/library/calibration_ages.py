"""How old a rig's calibration is: `check` and `devices check` tell it, and nothing is refused for it."""

from collections.abc import Iterator
from datetime import datetime

from labrig.devices.can_description import ONLY_SIMULATED
from labrig.devices.check_result import CheckResult, passed, warned
from labrig.devices.rig_file import RigDescription
from labrig.text import format_count
from labrig.vision.calibration_file import read_creation_time

_OLD_DAYS = 30


def list_calibration_ages(rig: RigDescription, now: datetime) -> Iterator[CheckResult]:
    """Yield the age of each file of a rig's calibration; on a bench the camera is touched sooner or later."""
    again = "calibrate again where the camera or its lens has been touched"
    for name, path in rig.calibration_paths().items():
        check = f"calibration {name.removesuffix('.json')} age"
        if not path.is_file():
            continue
        if (made := read_creation_time(path)) is None:
            yield warned(check, "when it was made is not known", again)
            continue
        days = (now - made).days
        value = f"{format_count(days, 'day')}, made {made:%Y-%m-%d}"
        is_old = rig.kind != ONLY_SIMULATED and days > _OLD_DAYS
        yield warned(check, value, again) if is_old else passed(check, value)
