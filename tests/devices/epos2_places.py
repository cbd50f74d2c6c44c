"""Objects of an EPOS2's maker, by their places."""

from labrig.devices.drives.objects import Place

CONFIGURATION = (Place(0x1020, 1), Place(0x1020, 2))
INPUT_STATE, INPUT_MASK, LIMIT_EXECUTION_MASK = Place(0x2071, 1), Place(0x2071, 2), Place(0x2071, 4)
FOLLOWING_ERROR_ACTUAL = Place(0x20F4)
ENCODER_PULSES = Place(0x2210, 1)
CURRENT_LIMIT, MAX_MOTOR_SPEED = Place(0x6410, 2), Place(0x6410, 4)
