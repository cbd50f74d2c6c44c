"""Simulated devices: drives on a CAN bus, and camera and operator in a simulated world.

What is decided here
--------------------
- The seam is at the wire. A simulated drive is a CANopen node with the object dictionary of its kind, SDO, NMT,
  heartbeat, PDO, EMCY and its state machine; the driver that talks to it is the driver of real drives, and
  third-party CANopen clients can drive it too (`serving`).
- Inside a process frames are delivered synchronously: when `send` returns, every node has received the frame and
  answered it, unless a fault is scripted. No thread and no real-time timeout decides anything.
- Motion is a closed form of simulated time. Drives follow their profile exactly; stops and blockages hold a shaft,
  and show in the motor current (`shaft`). The journal of a drive has each event with its exact instant.
- `clock: real` rehearses a bench: the same drives and the same world in the computer's time, in the thread that
  supervises, which tells them of it whenever it sends a frame, takes a picture or waits. So a labrig that hangs
  stops those drives too. A person is asked, and what they confirm is done in the world.
- A script injects faults of the bus (`bus`), of the node (`node`) or of the motor (`cia402`), which
  decide what follows. What befalls single frames is done by tests, which catch them on the wire.
- Where documents are ambiguous, the simulation takes the dangerous reading: releasing Halt resumes the old
  target, a drive moves towards a target beyond the software limits until it passes the limit, an axis moves on
  through NMT stop and reset communication, and a homing search without a stop never ends.
- Unsure, for want of a device to compare with: whether the errors that only the EPOS2 has (0x5114, 0xFF0C to 0xFF12)
  brake, as here, or switch the power stage off at once; the order in which a mapping may be written; the bits of
  0x2071:01; ranges of 0x2070; the defaults of 0x6007 and of 0x6410:02, here 25000 mA, which is more than a 24/5 gives;
  whether the attained bit of a homing outlives power off, as here.
- Left out is what labrig's driver does not use: other modes than profile position and homing, set-points that wait or
  are relative, PDOs that are received, requested or sent on change, node guarding, storing, homing to the home switch
  alone, another reaction to a lost heartbeat than a fault, errors older than the newest, and SDO transfers of more than
  four bytes, in segments or in blocks.
"""
