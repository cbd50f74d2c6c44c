"""The replayed rig: clock, bus, camera and operator of a record, for the same drivers and the same experiments.

The seam is at the wire, as it is for simulation: axes and drivers are the real ones, and what they send is compared
with what can.log holds. A command (a write to a drive, NMT, a process-data frame) has to be the recorded one; the
number of reads may differ, as it does where time is real, and heartbeats are no commands. The answers are the
recorded ones, so that a fault of a drive comes back too.
"""
