"""Simulated devices: drives on a CAN bus, and camera and operator in a simulated world.

What is decided here
--------------------
- The seam is at the wire. A simulated drive is a CANopen node with the object dictionary of its kind, SDO, NMT,
  heartbeat, guarding, PDO, EMCY and its state machine; the driver that talks to it is the one for real drives, and
  CANopen clients that nobody here wrote drive it too (`serving`).
- Inside a process frames are delivered synchronously: when `send` returns, everybody has taken the frame and
  answered it, unless a fault is scripted. No thread and no timeout of the computer's time decides anything.
- Motion is a closed form of simulated time. Drives follow their profile exactly; there is no load, but a shaft runs
  against stops, switches and what blocks it. What a drive does is in its journal with the exact instant.
- A fault that a script injects is one of the bus (`bus`), of the node (`node`) or of the motor (`cia402_node`); what
  follows from it is left to them.
- Where documents leave it open, the dangerous reading is taken: releasing Halt resumes the old target, a target
  beyond the software limits is driven at until the limit is passed, NMT stop and reset communication leave a
  moving axis moving, a new target velocity acts at once, homing without an end goes on for ever.
- Unsure, for want of a device to compare with: which errors other than over-current and over-voltage switch the
  power stage off at once instead of braking; the order in which a mapping may be written; COB-IDs of PDOs after
  0x1011:05; that only 1, 253 and 255 are transmission types; the bits of 0x2071:01; ranges of 0x2070 and 0x6410.
- Left out: interpolated, current, velocity, position and master encoder modes, which change the mode display and
  move nothing; sin2 profiles; storing to flash takes no time; SDO block transfer is refused, as by the drive.
"""
