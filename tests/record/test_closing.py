"""Closing a run: it checks itself, and says so when it is damaged."""

from pathlib import Path

import pytest

from labrig.errors import BugError, DiskError, InputError, RecordError
from labrig.record.check import check_run
from labrig.record.manifest import read_manifest
from labrig.record.pictures import Store
from labrig.record.reader import open_run
from labrig.record.writer import Recorder
from tests.disks import full_disk
from tests.record.faults import CAN_FRAMES, flip_bit, raw_files
from tests.record.runs import ENDED, begin, fill, picture

STORES: tuple[Store, ...] = ("png", "raw")
WRITTEN = [(store, name) for store in STORES for name in raw_files(store) if name != "manifest.json"]


@pytest.mark.parametrize(("store", "name"), WRITTEN)
def test_a_run_that_a_disk_has_changed_is_marked_when_it_closes(
    tmp_path: Path, store: Store, name: str
) -> None:
    """It is kept and closed as failed; the error, the manifest and every later check name the file."""
    recorder = begin(tmp_path, store=store)
    recorder.can_frames(CAN_FRAMES)
    fill(recorder)
    intact = (recorder.path / name).read_bytes()
    flip_bit(recorder.path / name)
    with pytest.raises(BugError, match=name) as caught:
        recorder.close("success", "", ENDED)
    assert caught.value.exit_code == 5
    manifest = read_manifest(recorder.path)
    assert manifest["exit_status"] == "failed"
    assert name in str(manifest["reason"])
    assert str(manifest["reason"]).endswith("it had ended as success")
    (recorder.path / name).write_bytes(intact)
    assert "the run was damaged when labrig closed it" in check_run(recorder.path).damage[0].message
    assert name in open_run(recorder.path).damage[0].message
    with pytest.raises(RecordError, match=name):
        Recorder.reopen(recorder.path, "a test")


@pytest.mark.parametrize("store", STORES)
def test_a_picture_without_a_line_is_not_kept(tmp_path: Path, store: Store) -> None:
    """A picture whose line is refused is taken back, so that the closed run is sound."""
    recorder = begin(tmp_path, store=store)
    fill(recorder)
    with pytest.raises(InputError):
        recorder.frame(picture(9), 30.0, trial=None, unknown=object())
    recorder.frame(picture(4), 31.0, trial=None)
    recorder.close("success", "", ENDED)
    verdict = check_run(recorder.path)
    assert (verdict.damage, verdict.frames) == ((), 5)


def test_a_picture_of_the_trial_that_would_come_next_is_sound(tmp_path: Path) -> None:
    """A run that ends between a trial's first picture and its start has lost nothing."""
    recorder = begin(tmp_path)
    recorder.frame(picture(0), 0.5, trial=0, role="target")
    recorder.close("aborted", "stopped", ENDED)
    assert check_run(recorder.path).damage == ()


def test_can_frames_without_a_sum_get_it_when_the_run_closes(tmp_path: Path) -> None:
    """A disk that takes the frames and refuses their sum ends the run with a sound record of these frames."""
    recorder = begin(tmp_path)
    for frame in CAN_FRAMES:
        recorder.can_frames([frame])
    sums = (recorder.path / "can.sums.jsonl").stat().st_size
    with full_disk(sums), pytest.raises(DiskError, match=r"can\.sums\.jsonl"):
        recorder.can_frames([(0.002, 0x701, b"\x05", "R")])
    recorder.close("failed", "", ENDED)
    assert check_run(recorder.path).damage == ()
    assert [frame.can_id for frame in open_run(recorder.path).can_frames][-1] == 0x701
