"""experiments: a folder for each experiment, and the registry that finds them.

An experiment's `__init__.py` is a declaration: its name, its title, and the place of each of its parts. The parts are
`protocol.py` (its model), `procedure.py` (what it does on a rig), `events.py` (what it writes), `analysis.py` (run ->
result), `result.py` (the result's model and tables) and `page.py` with its template. `tracks.py`, where there is one,
says which tracks a run leaves in blocks of gel that have a file. `view.py` adds to the rerun view
of a run that was measured (`view`) and of one that is being made (`follow`). `virtual.py`, where there is one, computes
a run without pictures (`simulate`), thousands of which make a campaign. The registry reads declarations from the
entry-point group `labrig.experiments`, labrig's own and those of other packages alike, and imports a part when it is
first used: neither a list of runs nor an analysis loads a procedure or a bus.

What computes never reaches what moves: `analysis`, `page`, `result`, `events` and `protocol` import neither `runner`
nor `devices` nor a procedure. No experiment imports another; what two share stands in `shared/` or in a room below.

- `steerability`: section V-B of the paper, insertions without turning the bevel, gel by gel
- `insertion`: section V-C, steering to a target between obstacles, with feedback from the camera
- `roll_zero`: which roll of the rotation axis bends the needle towards -y
- `camera_calibration`: the lens by a chessboard (Zhang 1999), the steering plane by graph paper
- `hinge_design`: section III, what to cut for a radius; moves nothing
- `imported_pictures`: pictures that were taken elsewhere, made into a run by `labrig import`
"""

from labrig.experiments.declaration import ExperimentDeclaration

__all__ = ["ExperimentDeclaration"]
