"""What the rig remembers across runs, and what it does if it cannot."""

import json
from pathlib import Path

import pytest

from labrig.devices.needle_state import NeedleState, RigState, RollZero
from labrig.errors import DiskError
from labrig.steering.torsion import TorsionalLag


def test_a_state_survives_the_process(tmp_path: Path) -> None:
    """Another store reads what a store has written, with the roll zero and torsion of its own needle alone."""
    path = tmp_path / "state.json"
    zero = RollZero("N1", -0.31, 0.01, "20261121-roll-zero", TorsionalLag(0.01, 0.002, 50.0, 0.01, 0.0003))
    NeedleState(path).update(
        needle_in_tissue=True, since_run="run-1", referenced=("rotation",), roll_zero=zero, note=""
    )
    again = NeedleState(path)
    assert again.state == RigState(True, "run-1", ("rotation",), "", zero)
    assert (again.recall_roll_zero("N1"), again.recall_roll_zero("N2")) == (zero, None)
    assert [entry.name for entry in tmp_path.iterdir()] == ["state.json"]


def test_without_a_path_nothing_is_remembered() -> None:
    """A simulated rig is new in every run, with no needle in tissue."""
    store = NeedleState(None)
    store.update(needle_in_tissue=True, since_run="run-1")
    assert NeedleState(None).state.needle_in_tissue is False


def test_no_file_is_a_doubt(tmp_path: Path) -> None:
    """At a rig that has never been used, a needle may be in tissue."""
    state = NeedleState(tmp_path / "state.json").state
    assert state.needle_in_tissue is None
    assert "no state file yet" in state.doubt


_STATE = {"kind": "labrig-rig-state", "schema_version": 1, "needle_in_tissue": False, "referenced": []}


_ZERO = {"needle_id": "N1", "zero_rad": 0, "sd_rad": 0, "run": "a"}


@pytest.mark.parametrize(
    "content",
    [
        b"",
        {"schema_version": 2},
        {"needle_in_tissue": "no"},
        {"referenced": "insertion"},
        {"roll_zero": "none"},
        {"roll_zero": {"needle_id": "N1"}},
        {"roll_zero": {**_ZERO, "zero_rad": "x"}},
        {"roll_zero": {**_ZERO, "sd_rad": -1}},
        {"roll_zero": {**_ZERO, "torsion": {"best_sd_rad": -1}}},
    ],
)
def test_a_damaged_file_is_a_doubt_with_a_reason(tmp_path: Path, content: bytes | dict[str, object]) -> None:
    """An unreadable file never counts as no needle in tissue."""
    path = tmp_path / "state.json"
    path.write_bytes(content if isinstance(content, bytes) else json.dumps(_STATE | content).encode())
    state = NeedleState(path).state
    assert state == RigState(None, note=state.note)
    assert "state.json cannot be read" in state.doubt


def test_a_state_that_cannot_be_written_is_an_error(tmp_path: Path) -> None:
    """Without it no needle goes into tissue."""
    with pytest.raises(DiskError):
        NeedleState(tmp_path / "missing" / "state.json").update(needle_in_tissue=True)


@pytest.mark.parametrize("left", [(), ("insertion", "linear")])
def test_a_roll_zero_goes_with_the_reference_of_the_rotation_axis(
    tmp_path: Path, left: tuple[str, ...]
) -> None:
    """Power loss and a new zero of the axes end the reference, and with it the roll zero."""
    store = NeedleState(tmp_path / "rig.state.json")
    zero = RollZero("N1", -0.31, 0.01, "20261121-roll-zero")
    store.update(needle_in_tissue=False, referenced=("insertion", "rotation", "linear"), roll_zero=zero)
    store.update(referenced=left)
    store.update(referenced=("insertion", "rotation", "linear"))
    assert NeedleState(tmp_path / "rig.state.json").state.roll_zero is None
