"""Opens the rig of a record."""

from collections.abc import Iterator
from contextlib import closing, contextmanager
from itertools import pairwise
from pathlib import Path

from labrig.devices.canopen_objects import TARGET_POSITION
from labrig.devices.needle_state import NeedleState
from labrig.devices.replayed.comparison import Comparison
from labrig.devices.replayed.hardware import ReplayedHardware
from labrig.devices.replayed.recording import Recording
from labrig.devices.rig import MIXED_LOOKS, WHOLE, Guards, Opening, Rig
from labrig.devices.rig_file import RigDescription, kept_name, load_rig
from labrig.errors import InputError
from labrig.plugins import require_devices_installed
from labrig.record.reader import Run

_ASKS_TARGET = b"\x40" + TARGET_POSITION.index.to_bytes(2, "little") + bytes(5)
# Between two looks at a target pass 0.15 s; the answers of other drives shift that by milliseconds.
_SOONER_S = 0.12


def load_recorded_rig(run: Run) -> RigDescription:
    """Return the rig of a run, with the calibration that the run holds.

    Raises
    ------
    InputError
        When the run had no rig, or a drive or camera of it is not installed.
    RecordError
        When its rig file is missing or was changed, or a calibration file was changed or added.
    """
    if run.rig_path is None:
        raise InputError(f"{run.path} had no rig", "it moved nothing")
    require_devices_installed(str(run.path), run.plugin_packages)
    description = load_rig(run.rig_path)
    named = {key: value for key, value in description.calibration if value is not None}
    held = {key: f"{key}{Path(value).suffix}" for key, value in named.items()}
    calibration = description.calibration.model_copy(update=held)
    axes = {
        name: axis.model_copy(update={key: kept_name(name, key, path) for key, path in axis.files.items()})
        for name, axis in description.axes.items()
    }
    placed = description.model_copy(
        update={"calibration": calibration, "axes": description.axes.model_copy(update=axes)}
    )
    placed = placed.placed_in(run.own("calibration"))
    for name in placed.calibration_files():
        run.calibration_path(name)  # refuses a file that was changed, or that the run did not begin with
    return placed


@contextmanager
def open_replayed(
    description: RigDescription,
    recording: Recording,
    comparison: Comparison,
    opening: Opening = WHOLE,
) -> Iterator[tuple[Rig, ReplayedHardware]]:
    """Open the rig of a recorded session; nothing outside the process is touched, not even a state file.

    Leaving the block does not stop it: what was sent to close it is not part of the record.

    Raises
    ------
    ReplayDiffersError, RecordEndsError
        When connecting differs already, or the record ends while connecting.
    """
    hardware = ReplayedHardware(description, recording, comparison)
    # To find out takes a look at every frame.
    sparing = recording.guards != MIXED_LOOKS or not _asks_targets_often(recording)
    guards = Guards.recorded(recording.guards, exact=recording.exact, sparing=sparing)
    with closing(hardware.open_link()) as link:
        rig = Rig(
            description,
            hardware=hardware,
            link=link,
            source=hardware.open_source(),
            person=hardware.operator,
            interrupted=hardware.find_signal,
            opening=opening,
            needle=NeedleState(None, recording.state),
            guards=guards,
        )
        rig.verify()
        if not guards.steady:
            rig.enable()
        yield rig, hardware


def _asks_targets_often(recording: Recording) -> bool:
    """Return whether an axis was asked for its target sooner than it is now."""
    asked = sorted(
        (frame.can_id, frame.t_s)
        for frame in recording.can_frames
        if frame.way == "T" and frame.data == _ASKS_TARGET
    )
    return any(
        drive == same and again_s - once_s < _SOONER_S for (drive, once_s), (same, again_s) in pairwise(asked)
    )
