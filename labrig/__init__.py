"""labrig runs needle-steering experiments from protocol files and keeps a record of everything they did.

Rooms, top to bottom; each may import only what stands below it (`lint-imports` holds that):

- `cli` parses, chooses the rig, calls, prints; alone prints, prompts and exits
- `campaign` repeats a protocol virtually, thousands of times, and makes one table of it
- `testing` holds the tests that every driver passes, ours and a lab's own
- `experiments` has a folder for each experiment, and the registry that finds them
- `runner` is what every run needs: the interface of an experiment, the session, plan, resume, replay, withdrawal
- `devices` are the axes, the camera, the clock and the operator, the rig that holds them, and a folder for each driver
- `simulation` is the world that simulated devices live in, and knows none of our models of it
- `report` draws and writes what others computed
- `analysis` turns a run into a result, with uncertainty
- `record` is a run on disk
- `protocol` turns YAML into frozen, validated protocols
- `steering` plans a path, estimates the pose of the tip, and joins the two in a step
- `needle` is what the needle is: the design of its hinges, and what it can reach
- `vision` turns pixels into mm
- `lab` is the folder of a lab: its protocols, rig files and runs, and the examples that it starts with
- `durable` writes files whole or not at all, under names of its own until they are complete
- `posix` is what the operating system must give
- `plugins` finds the experiments, drives and cameras of installed packages
- `input_file` reads files and JSON that anybody may have made, within bounds
- `errors`, `clock` and `text` are the error tree, what a clock is, and how numbers are written

Beside them, `manual` holds the manual, and in `manual/example` a package of a lab's own to copy; it is imported by
nothing.

A name is imported from the file that defines it, so that a command loads what it needs: `labrig runs` lists thousands
of runs without pandas or OpenCV. The `__init__` of a room holds its docstring, and the names of the documented Python
interface.

Units, frames, signs and the paper's symbols are those of one page, `labrig/manual/reference/conventions.md`.

A run is a file; everything that computes reads it, and nothing that computes can move a motor.
"""

from importlib import import_module

__version__: str


def __getattr__(name: str) -> str:
    """Return `__version__`, that of the installed package; reading it takes 10 ms, so it is read when asked for."""
    if name != "__version__":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    metadata = import_module("importlib.metadata")
    try:
        return str(metadata.version("labrig"))
    except metadata.PackageNotFoundError:
        return "that is not installed"
