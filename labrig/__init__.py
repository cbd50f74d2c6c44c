"""labrig runs needle-steering experiments from protocol files and keeps a record of everything they did.

Rooms, top to bottom; each may import only what stands below it (`lint-imports` holds that):

- `cli` parses, calls, prints; alone prints, prompts and exits
- `campaign` repeats a protocol virtually, thousands of times, and makes one table of it
- `library` is what the commands and a notebook call
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
- `posix` holds signals, worker processes and terminals, as Linux has them
- `plugins` finds the experiments, drives and cameras of installed packages
- `input_file` reads files and JSON that anybody may have made, within bounds
- `errors`, `clock` and `text` are the error tree, what a clock is, and how numbers are written

Beside them, `manual` holds the manual, and in `manual/example` a package of a lab's own to copy; it is imported by
nothing.

A name is imported from the file that defines it, so that a command loads what it needs: `labrig runs` lists thousands
of runs without pandas or OpenCV. The `__init__` of a room holds its docstring, and the names of the documented Python
interface.

Units, frames, signs and the paper's symbols are those of one page, `labrig/manual/reference/conventions.md`.

**The library is the door.** A notebook calls what the commands call, and each name is imported when it is asked for:

>>> import labrig
>>> run = labrig.run("steerability", seed=3)  # or labrig.open_run("last")
>>> run.measurements, run.steps, run.trials, run.events, run.states  # DataFrames, units in their names
>>> run.pictures[0], run.result
>>> labrig.reanalyze(run, settings=["analysis.window_start_mm=6"])
>>> labrig.compare([run, "last"]), labrig.load_runs(where="tag=pilot"), labrig.run_campaign("campaign-reach")

A run is a file; everything that computes reads it, and nothing that computes can move a motor.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from labrig.analysis import load_runs as load_runs
    from labrig.campaign.run import run_campaign as run_campaign
    from labrig.library.door import check as check
    from labrig.library.door import compare as compare
    from labrig.library.door import differences as differences
    from labrig.library.door import open_run as open_run
    from labrig.library.door import reanalyze as reanalyze
    from labrig.library.door import replay as replay
    from labrig.library.door import resume as resume
    from labrig.library.door import run as run
    from labrig.library.door import view as view
    from labrig.library.door import write_report as write_report
    from labrig.record.notes import annotate_run as annotate_run
    from labrig.vision import calibrate_intrinsics as calibrate_intrinsics
    from labrig.vision import load_intrinsics as load_intrinsics
    from labrig.vision import load_plane as load_plane

__version__: str

_HANDED_OUT = {
    "labrig.analysis": ("load_runs",),
    "labrig.campaign.run": ("run_campaign",),
    "labrig.library.door": (
        *("check", "compare", "differences", "open_run", "reanalyze", "replay", "resume", "run", "view"),
        "write_report",
    ),
    "labrig.record.notes": ("annotate_run",),
    "labrig.vision": ("calibrate_intrinsics", "load_intrinsics", "load_plane"),
}
_PLACES = {name: place for place, names in _HANDED_OUT.items() for name in names}


def __getattr__(name: str) -> Any:
    """Import what is asked for: the door's functions take a second to load, `__version__` 10 ms."""
    if name in _PLACES:
        return getattr(import_module(_PLACES[name]), name)
    if name != "__version__":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    metadata = import_module("importlib.metadata")
    try:
        return str(metadata.version("labrig"))
    except metadata.PackageNotFoundError:
        return "that is not installed"


def __dir__() -> list[str]:
    """List what is handed out, for completion."""
    return sorted((*globals(), *_PLACES))
