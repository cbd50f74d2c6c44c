"""The objects of a CiA 402 drive: those that labrig needs, and those that it uses if the drive has them."""

from labrig.devices import canopen_objects as co
from labrig.devices.canopen_objects import Entry

ERROR_CODE = Entry(0x603F, 0, "error code", "H", "ro")
QUICK_STOP_OPTION = Entry(0x605A, 0, "quick stop option code", "h")
HALT_OPTION = Entry(0x605D, 0, "halt option code", "h")
FOLLOWING_ERROR_TIMEOUT = Entry(0x6066, 0, "following error timeout", "H")
MAX_CURRENT = Entry(0x6073, 0, "maximal current, per mille of the rated one", "H")
RATED_CURRENT = Entry(0x6075, 0, "rated current [mA]", "I")
TORQUE_ACTUAL = Entry(0x6077, 0, "torque actual, per mille of the rated one", "h", "ro")
FOLLOWING_ERROR = Entry(0x60F4, 0, "following error actual", "i", "ro")
DIGITAL_INPUTS = Entry(0x60FD, 0, "digital inputs", "I", "ro")
VELOCITY_UNIT = Entry(0x60A9, 0, "SI unit of velocity", "I")
ACCELERATION_UNIT = Entry(0x60AA, 0, "SI unit of acceleration", "I")

WRITTEN = (
    co.CONSUMER_HEARTBEAT,
    co.PRODUCER_HEARTBEAT,
    co.CONTROLWORD,
    co.MODE,
    co.TARGET_POSITION,
    co.PROFILE_VELOCITY,
    co.PROFILE_ACCELERATION,
    co.QUICK_STOP_DECELERATION,
    co.HOMING_METHOD,
)
READ = (
    co.DEVICE_TYPE,
    co.ERROR_REGISTER,
    co.VENDOR_ID,
    co.PRODUCT_CODE,
    co.STATUSWORD,
    co.POSITION_ACTUAL,
)
"""These and `WRITTEN` are required: profile position mode, homing, and the stop on a lost heartbeat."""

GUARDS = {
    co.ABORT_CONNECTION: "what the drive does when the computer's heartbeat stops (0x6007)",
    co.FAULT_REACTION: "how it stops on a fault (0x605E)",
    co.SHUTDOWN_OPTION: "how it stops when it is switched off (0x605B)",
    co.DISABLE_OPTION: "how it stops when operation is disabled (0x605C)",
    QUICK_STOP_OPTION: "how it stops on a quick stop (0x605A)",
    co.MAX_FOLLOWING_ERROR: "an axis that lags behind (0x6065)",
    co.LOWER_LIMIT: "the lower limit in the drive (0x607D:01)",
    co.UPPER_LIMIT: "the upper limit in the drive (0x607D:02)",
}
"""Objects that keep an axis safe -> what is not guarded in a drive that lacks them."""
