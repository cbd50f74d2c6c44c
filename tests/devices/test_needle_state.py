"""What the rig remembers across runs, and what it does if it cannot."""

import json
from pathlib import Path

import pytest

from labrig.devices.check import check_rig
from labrig.devices.exclusive import acquire_rig
from labrig.devices.needle_state import NeedleState, RigState, RollZero
from labrig.errors import DiskError, OutputExistsError
from labrig.steering.torsion import TorsionalLag
from tests.devices.rigs import simulated_rig

ZERO = RollZero("N1", -0.31, 0.01, "20261121-roll-zero", TorsionalLag(0.01, 0.002, 50.0, 0.01, 0.0003))


def test_a_state_survives_the_process(tmp_path: Path) -> None:
    """Another store reads what a store has written, with the roll zero and torsion of its own needle alone."""
    path = tmp_path / "state.json"
    NeedleState(path).update(
        needle_in_tissue=True, since_run="run-1", referenced=("rotation",), roll_zero=ZERO, note=""
    )
    again = NeedleState(path)
    assert again.state == RigState(True, "run-1", ("rotation",), "", ZERO)
    assert (again.recall_roll_zero("N1"), again.recall_roll_zero("N2")) == (ZERO, None)
    assert [entry.name for entry in tmp_path.iterdir()] == ["state.json"]


_STATE = {"kind": "labrig-rig-state", "schema_version": 1, "needle_in_tissue": False, "referenced": []}
_ZERO = {"needle_id": "N1", "zero_rad": 0, "sd_rad": 0, "run": "a"}


@pytest.mark.parametrize(
    "content",
    [
        None, b"", b'{"kind": "labrig-rig-state", "schema_version": 1', {"schema_version": 2},
        {"needle_in_tissue": "no"}, {"referenced": "insertion"}, {"roll_zero": "none"},
        {"roll_zero": {"needle_id": "N1"}}, {"roll_zero": {**_ZERO, "zero_rad": "x"}},
        {"roll_zero": {**_ZERO, "sd_rad": -1}}, {"roll_zero": {**_ZERO, "torsion": {"best_sd_rad": -1}}},
    ],
)  # fmt: skip
def test_a_missing_or_damaged_file_is_a_doubt_with_a_reason(
    tmp_path: Path, content: bytes | dict[str, object] | None
) -> None:
    """An unreadable file never counts as no needle in tissue; the first change replaces it."""
    path = tmp_path / "state.json"
    if content is not None:
        path.write_bytes(content if isinstance(content, bytes) else json.dumps(_STATE | content).encode())
    state = NeedleState(path).state
    assert state == RigState(None, note=state.note)
    assert ("no state file yet" if content is None else "state.json cannot be read") in state.doubt
    NeedleState(path).mark_out()
    assert NeedleState(path).state == RigState(False)


@pytest.mark.parametrize("content", ["Notes of today.\n", '{"kind": "labrig-plane"}', "{"])
def test_a_state_file_never_replaces_a_file_of_something_else(tmp_path: Path, content: str) -> None:
    """A rig whose state_file names notes is not opened, devices check fails, and the notes are as they were."""
    rig, path = simulated_rig("state_file=state.json").placed_in(tmp_path), tmp_path / "state.json"
    path.write_text(content)
    with (
        pytest.raises(OutputExistsError, match=r"state\.json is named as the state file") as refused,
        acquire_rig(rig, "labrig run"),
    ):
        pass
    assert ("state_file:" in refused.value.hint, path.read_text()) == (True, content)
    assert {result.check: result.status for result in check_rig(rig)}["rig state"] == "FAIL"


def test_a_state_that_cannot_be_written_is_an_error(tmp_path: Path) -> None:
    """Without it no needle goes into tissue."""
    with pytest.raises(DiskError):
        NeedleState(tmp_path / "missing" / "state.json").mark_in_tissue("run-1")


@pytest.mark.parametrize("left", [(), ("insertion", "linear")])
def test_a_roll_zero_goes_with_the_reference_of_the_rotation_axis(
    tmp_path: Path, left: tuple[str, ...]
) -> None:
    """Power loss and a new zero of the axes end the reference, and with it the roll zero."""
    store, whole = NeedleState(tmp_path / "state.json"), ("insertion", "rotation", "linear")
    store.update(needle_in_tissue=False, referenced=whole, roll_zero=ZERO)
    store.update(referenced=left)
    store.update(referenced=whole)
    assert NeedleState(tmp_path / "state.json").state.roll_zero is None
