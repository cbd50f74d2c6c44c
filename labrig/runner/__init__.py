"""runner: what every run needs and no experiment owns.

An experiment is an `Experiment`, whose parts are found by their names. A procedure is a function of a protocol and a
`Session`: the rig, the recorder, and a receiver of progress. It moves, asks, takes pictures and appends to the record;
it prints nothing. What it sees, it sees through a `Sight`: a picture on a rig, the world on a virtual one.

A procedure is written once. `dry_run` carries it out on a virtual rig, with axes in closed form and neither bus nor
pictures: the plan of `labrig check` and `labrig run` is what it did there, and so are a campaign's virtual runs.

`conduct` switches power on and runs a procedure to an end that the record can state: success, failed (a trial, a device
or the computer failed) or aborted (a person or a signal stopped it). The axes stop in every case. It continues an
interrupted run with the same procedure, from what its record holds. Draws of a simulated world come from seed and
purpose, so the remainder is what it would have been. An experiment that moves nothing is recorded by
`conduct_without_rig`.

`Session.trials` yields the trials that remain (`trials`): planned, less begun, plus those that are made again. One that
finds nothing fails alone. A person may pause a run at its safe points: before and after each question, and at the end
of each trial; skip a trial, or have one made again. What is decided is an event, so that `Decisions`, a fold of the
events, is the same while the run is made, when it is resumed, and when it is evaluated.

Needle and sheath count as in tissue from before they move in until both are back at zero: the session sees to it.

Conditions of the protocol are judged on values that a procedure hands to `Session.judge`.
They act at the next safe point, in the place of a person's request.

The record is written by a worker, and long computations are made by one (`Session.compute`), while the thread of the
procedure supervises the rig.

`replay_run` runs the same procedures with the answers of a record, and compares what they ask and say: a procedure
therefore decides from nothing but the protocol, the rig file, the calibration and what its session returns. It calls
the session alone; the seam between session and rig is `labrig.devices.rig_calls`.

`withdraw` takes a needle out along its path and turns the bevel back wherever it was turned.
Graph paper before and after a run (`sentinel`) is handled by `graph_paper`, for every experiment.
"""
