"""experiments: a folder for each experiment, and the registry that finds them.

An experiment is an `Experiment` (`labrig.runner.experiment`), labrig's own and those of other packages alike, which an
entry point of the group `labrig.experiments` names. Its parts are found by their names: in one module, or, where that
grows, in a folder of `protocol.py` (its model), `procedure.py` (what it does on a rig), `events.py` (what it writes),
`analysis.py` (run -> result), `result.py`, `page.py` with its template, `view.py` (additions to the rerun view) and
`virtual.py` (what a campaign is told of a virtual run). A part is imported when it is first used.

What computes never reaches what moves: `analysis`, `page`, `result`, `events` and `protocol` import neither `runner`
nor `devices` nor a procedure. No experiment imports another; what two share stands in `shared/` or in a room below.

- `steerability`: section V-B of the paper, insertions without turning the bevel, gel by gel
- `insertion`: section V-C, steering to a target between obstacles, with feedback from the camera
- `roll_zero`: which roll of the rotation axis bends the needle towards -y
- `camera_calibration`: the lens by a chessboard (Zhang 1999), the steering plane by graph paper
- `hinge_design`: section III, what to cut for a radius; moves nothing
- `imported_pictures`: pictures that were taken elsewhere, made into a run by `labrig import`
"""

from labrig.runner.experiment import Experiment

__all__ = ["Experiment"]
