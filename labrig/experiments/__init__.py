"""experiments: the procedures that move the rig.

A procedure is a function of a protocol and a `Session`: the opened rig, the recorder, and where progress is told. It
moves, asks, takes pictures and appends to the record; it prints nothing. What it is going to do is known before it
starts, as a list of `PlannedMove`, so that `labrig check` and `labrig run` refuse the same protocols.

An insertion alone decides from pictures what it does next, through `vision` and `steering`, which know no rig. It
rests on the needle's roll zero, which the rig's state holds while the needle is clamped as it was. A picture in which
nothing is seen stops the axes and leaves the needle where it is; a target that is missed, or a tip that is lost, ends
with the needle withdrawn. Where the protocol has `sheath.origin`, the sheath is found in the picture taken once it is
in: the insertion starts there, a roll zero is told from there, and no needle leaves a sheath that stands elsewhere
than origin and linear encoder allow. A protocol without it, as in records of before, starts at the plane's origin.

Graph paper before and after a run (`sentinel`) is asked for by one function, whatever the experiment (`bench`).

`replay_run` drives the same procedures with the devices of a record and compares: a procedure therefore decides from
nothing but what protocol, rig file, calibration and devices tell it.

A needle is taken out by `withdraw`, back along the path by which it came: its bevel is turned back where it was turned.

`conduct` runs a procedure to an end that the record can state: success, aborted (a person or a signal stopped it) or
failed (a device or the computer did), with the axes stopped in every case. `conduct_rest` goes on with a sweep that was
interrupted: `past_of` reads what its record holds, the rest is scheduled, and draws of a simulated world come from seed
and purpose, so that the rest is what it would have been. A design moves nothing: its record is made
by `conduct_without_rig`, and nothing is planned for it.
"""
