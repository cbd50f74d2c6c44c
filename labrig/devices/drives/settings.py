"""The settings that an axis needs of its drive, and whether the drive takes them, by its EDS file."""

from collections.abc import Iterator

from labrig.devices.axis_description import AxisDescription
from labrig.devices.drives import objects as co
from labrig.devices.drives.drive import HOMING_HERE, Homing
from labrig.devices.drives.eds import find_bounds, read_own_eds
from labrig.devices.drives.model import Model
from labrig.devices.drives.objects import Place
from labrig.errors import InputError
from labrig.protocol.model import Conflict

_WITHOUT_IT = "labrig needs it: use the EDS file of this drive, name another object, or use another drive"


def list_settings(axis: AxisDescription, model: Model) -> dict[Place, int]:
    """Return the settings of the axis that the drive takes. Raises `InputError` if its gear is unknown."""
    scale = axis.scale()
    acceleration = scale.to_acceleration_units(axis.acceleration)
    wanted = {
        co.MAX_FOLLOWING_ERROR: scale.to_distance_counts(axis.max_following_error),
        co.POSITION_WINDOW: scale.to_distance_counts(axis.position_window),
        co.POSITION_WINDOW_TIME: axis.position_window_time_ms,
        co.MAX_PROFILE_VELOCITY: scale.to_speed_units(axis.max_speed),
        co.PROFILE_ACCELERATION: acceleration,
        co.PROFILE_DECELERATION: acceleration,
        co.QUICK_STOP_DECELERATION: scale.to_acceleration_units(axis.quick_stop_deceleration),
        co.PROFILE_TYPE: 0,
        **model.settings,
    }
    return {place: value for place, value in wanted.items() if model.takes(place)}


def list_homing_settings(axis: AxisDescription, model: Model, homing: Homing) -> dict[Place, int]:
    """Return the settings that a homing needs. Raises `InputError` if the drive lacks one of them."""
    scale, method = axis.scale(), homing.method
    if (homing.offset and model.home_offset is None) or (homing.position and model.home_position is None):
        raise InputError(
            f"homing has position {homing.position:g} and offset {homing.offset:g}, and no object of the drive is "
            "known for one of them",
            "write 0, and jog after homing; or name the object of the position in objects.home_position",
        )
    units = scale.to_speed_units(homing.speed)
    away = -axis.homing_directions.get(method, 0)
    wanted: dict[Place | None, int | None] = {
        co.HOMING_METHOD: model.home_here if method == HOMING_HERE else method,
        co.HOME_OFFSET: 0,
        model.home_offset: away * round(homing.offset * scale.counts_per_unit),
        model.home_position: scale.to_counts(homing.position),
        model.homing_current: axis.homing_current_ma(method),
    }
    if method != HOMING_HERE:
        wanted |= {
            co.HOMING_SPEED_SWITCH: units,
            co.HOMING_SPEED_INDEX: max(1, units // 10),
            co.HOMING_ACCELERATION: scale.to_acceleration_units(axis.acceleration),
        }
    return {at: value for at, value in wanted.items() if at and value is not None and model.has(at)}


def find_conflicts(axis: AxisDescription) -> Iterator[Conflict]:
    """Yield an EDS file that cannot be used for this section, and values that the drive does not take."""
    settings = dict[Place, int]()
    try:
        model = axis.model()
        if not axis.unknown:
            settings = {**list_settings(axis, model), **model.stop_options}
            list_homing_settings(axis, model, axis.homing)
    except InputError as error:
        yield Conflict("driver", error.message, error.hint)
        return
    names = {place: f" ({found.name})" for place, found in read_own_eds("cia402.eds").objects.items()}
    for place in (*names, *model.needs):
        if not model.has(place):
            lacking = f"{model.eds.source} has no object {place}{names.get(place, '')}"
            yield Conflict("driver", lacking, _WITHOUT_IT)
    ends = ((co.TARGET_POSITION, axis.scale().to_counts(limit)) for limit in axis.limits if settings)
    for place, value in (*settings.items(), *ends):
        low, high = find_bounds(model.eds.objects[place]) if model.takes(place) else (value, value)
        if not low <= value <= high:
            yield Conflict(
                "driver",
                f"{model.eds.objects[place].name} ({place}) would be {value}, the drive takes {low} to {high}",
                "check limits, speeds, accelerations, windows and units of this axis",
            )
