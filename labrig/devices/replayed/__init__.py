"""The replayed rig: it answers a procedure with what the rig of a record answered, in order.

The seam is that of `labrig.devices.rig_calls`. Nothing is sent on a bus: can.log is evidence, and the driver is proved
by its own tests at the wire.
"""
