"""labrig runs needle-steering experiments from protocol files and keeps a record of everything they did.

Rooms, top to bottom; each may import only what stands below it (`lint-imports` holds that):

- `cli` parses, chooses the rig, calls, prints; alone prints, prompts and exits
- `testing` holds the tests that every driver passes, ours and a lab's own
- `experiments` are the procedures that move the rig, and the record of those that move nothing
- `devices` are the axes, the camera, the clock and the operator, and the rig that holds them
- `simulation` is the world that simulated devices live in, and knows none of our models of it
- `report` draws and writes what others computed
- `analysis` turns a run into a result, with uncertainty
- `record` is a run on disk
- `protocol` turns YAML into frozen, validated protocols
- `needle` is what the needle is: the design of its hinges
- `vision` turns pixels into mm
- `geometry` holds frames, signs, units, and circle fits
- `errors` and `clock` are the error tree and what a clock is

A name is imported from the file that defines it, so that a command loads what it needs: `labrig runs` lists thousands
of runs without pandas or OpenCV. The `__init__` of a room holds its docstring, and the names of the documented Python
interface.

A run is a file; everything that computes reads it, and nothing that computes can move a motor.
"""

__version__ = "0.1.0"
