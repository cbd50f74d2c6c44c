"""Simulated devices: EPOS2 drives on a CAN bus inside the process, camera and operator in a simulated world.

What is decided here
--------------------
- The seam is at the wire. A simulated drive is a CANopen node with an object dictionary, an SDO server, NMT,
  EMCY and the state machine of an EPOS2; the driver that talks to it is the one for real drives.
- Frames are delivered synchronously: when `send` returns, everybody has taken the frame and answered it. No
  thread and no timeout of the computer's time decides anything.
- Motion is a closed form of simulated time. Drives follow their profile exactly; there is no load and no
  friction.
- Unsure, for want of a device to compare with: that releasing Halt resumes the old target (the dangerous
  reading), and that a target beyond the software limits is driven at until the limit is passed.
"""
