"""Runs whose disk is busy or whose camera hangs: the beat goes on, and labrig itself says what is wrong."""

from pathlib import Path

from labrig.devices.rig import Rig
from labrig.errors import CameraError
from labrig.experiments.declared import find_experiment
from labrig.record.check import check_run
from labrig.record.json_lines import LineFile
from labrig.record.reader import open_run
from labrig.record.writer import Recorder
from labrig.runner.conduct import Outcome, conduct
from labrig.runner.session import Session
from tests.devices.blocking import Blockade, threaded_rig
from tests.devices.rigs import simulated_rig
from tests.devices.wire_faults import listening, require_no_fault
from tests.runner.sessions import SHORT_WAY, Told, begin_record, sweep

PROTOCOL = sweep(*SHORT_WAY, "insertion.length_mm=10", "insertion.speed_mm_s=2", "insertion.frame_every_mm=2")
BUSY_S, LATE_S = 0.5, 0.1
QUADCOUNTS_PER_MM = 4000
LONGEST_GAP_S = 0.2
"""Two periods of the heartbeat."""


class SlowLines(LineFile):
    """A file whose fsync takes half a second of rig time."""

    blockade: Blockade | None = None

    def sync(self) -> None:
        """Force it to disk."""
        if self.blockade is not None:
            self.blockade.hold(BUSY_S)
        super().sync()


def conduct_sweep(rig: Rig, recorder: Recorder) -> Outcome:
    """Conduct a sweep of one insertion."""
    return conduct(find_experiment("steerability"), PROTOCOL, Session(rig, recorder, Told()))


def slow_down(recorder: Recorder, blockade: Blockade) -> None:
    """Make every fsync of a record's lines slow."""
    for name, lines in recorder._lines.items():
        lines.close()
        slow = SlowLines(lines.path)
        slow.blockade = blockade
        recorder._lines[name] = slow


def test_an_fsync_of_500_ms_delays_no_beat(tmp_path: Path) -> None:
    """The run succeeds, and its record is sound."""
    with threaded_rig() as (opened, hardware), listening(opened) as heard:
        opened.rig.verify()
        recorder = begin_record(tmp_path, PROTOCOL, opened.rig)
        slow_down(recorder, hardware.blockade)
        outcome = conduct_sweep(opened.rig, recorder)
        opened.rig.close()
        assert (outcome.exit_status, outcome.reason) == ("success", "")
        assert heard.longest_gap_s <= LONGEST_GAP_S
        require_no_fault(opened)
    assert not check_run(recorder.path).damage


def test_a_disk_that_takes_500_ms_for_everything_delays_no_beat(tmp_path: Path) -> None:
    """Record and state file: each waits for the disk, and the axes are supervised meanwhile."""
    remembering = simulated_rig("state_file=state.json").placed_in(tmp_path)
    with threaded_rig(remembering) as (opened, hardware), listening(opened) as heard:
        hardware.disk.busy_s = BUSY_S
        opened.rig.connect()
        opened.rig.needle.mark_out()
        opened.rig.reference_axes()
        opened.rig.axis("insertion").start_jog(1.0, 1.0)
        opened.rig.wait(1.5)
        opened.rig.close()
        assert heard.longest_gap_s <= LONGEST_GAP_S
        require_no_fault(opened)


def test_a_busy_computer_trips_nothing(tmp_path: Path) -> None:
    """Whatever waits is late by up to 0.1 s, and whatever the disk does takes as long."""
    with threaded_rig(late_s=LATE_S) as (opened, hardware), listening(opened) as heard:
        rig = opened.rig
        hardware.disk.busy_s = LATE_S
        rig.verify()
        outcome = conduct_sweep(rig, begin_record(tmp_path, PROTOCOL, rig))
        rig.close()
        assert (outcome.exit_status, outcome.reason) == ("success", "")
        assert heard.longest_gap_s <= LONGEST_GAP_S + 2 * LATE_S
        require_no_fault(opened)


def test_a_camera_that_hangs_stops_the_run_and_is_named(tmp_path: Path) -> None:
    """The axes hold at their targets until labrig gives the camera up; the drives do not stop by themselves."""
    with threaded_rig() as (opened, hardware), listening(opened) as heard:
        opened.rig.verify()
        recorder = begin_record(tmp_path, PROTOCOL, opened.rig)

        def hang_on_the_way() -> None:
            needle_mm = hardware.drives["insertion"].shaft_counts / QUADCOUNTS_PER_MM
            hardware.camera.hangs_s = 10.0 if needle_mm > 4.0 else 0.0

        hardware.clock.on_advance(hang_on_the_way)
        outcome = conduct_sweep(opened.rig, recorder)
        opened.rig.close()
        assert isinstance(outcome.error, CameraError)
        assert "the camera hangs: it has not answered for 3.3 s" in outcome.reason
        assert heard.longest_gap_s <= LONGEST_GAP_S
        require_no_fault(opened)
    assert open_run(recorder.path).manifest["exit_status"] == "failed"
