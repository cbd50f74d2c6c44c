"""runner: what every run needs and no experiment owns.

An experiment is handed over as an `Experiment`: what it plans, its procedure, how it goes on, what is shown of it. A
procedure is a function of a protocol and a `Session`: the rig, the recorder, and a receiver of progress. It moves,
asks, takes pictures and appends to the record; it prints nothing. What it is going to do is known before it starts,
as a `RunPlan`, so that `labrig check` and `labrig run` refuse the same protocols.

`conduct` switches power on and runs a procedure to an end that the record can state: success, aborted (a person or a
signal stopped it) or failed (a device or the computer failed). The axes stop in every case. `conduct_remainder`
continues an interrupted run. Draws of a simulated world come from seed and purpose, so the remainder is what it would
have been. An experiment that moves nothing is recorded by `conduct_without_rig`.

A person may pause a run at its safe points: before and after each question, and at the end of each trial, without any
code of the experiment; further ones are named by `Session.reach_safe_point`. A procedure that makes its trials through
`Session.attempt` lets a person skip one or have one made again. What is decided is an event, so that `Decisions`, a
fold of the events, is the same while the run is made, when it is resumed, and when it is evaluated.

Conditions of the protocol (`ask_when`, `stop_when`) are judged on values that a procedure hands to `Session.judge`.
They act at the next safe point, in the place of a person's request.

The record is written by a worker, and long computations are made by one (`Session.compute`), while the thread of the
procedure supervises the rig (`supervised_record`).

`replay_run` runs the same procedures with the answers of a record, and compares what they ask and say: a procedure
therefore decides from nothing but the protocol, the rig file, the calibration and what its session returns. It calls
the session alone; the seam between session and rig is `labrig.devices.rig_calls`.

`withdraw` takes a needle out along its path and turns the bevel back wherever it was turned.
Graph paper before and after a run (`sentinel`) is handled by `graph_paper`, for every experiment.
"""
