"""What the rig remembers across runs, and what it does when it cannot."""

import json
from pathlib import Path

import pytest

from labrig.devices.state import StateStore
from labrig.errors import DiskError


def test_a_state_survives_the_process(tmp_path: Path) -> None:
    """What one store writes, another reads."""
    path = tmp_path / "state.json"
    StateStore(path).update(needle_in_tissue=True, since_run="run-1", referenced=("insertion",), note="")
    state = StateStore(path).state
    assert (state.needle_in_tissue, state.since_run, state.referenced) == (True, "run-1", ("insertion",))
    assert [entry.name for entry in tmp_path.iterdir()] == ["state.json"]


def test_without_a_path_nothing_is_remembered() -> None:
    """A simulated rig is new in every run: no needle in tissue."""
    store = StateStore(None)
    store.update(needle_in_tissue=True, since_run="run-1")
    assert StateStore(None).state.needle_in_tissue is False


def test_no_file_is_a_doubt(tmp_path: Path) -> None:
    """Nobody knows whether a needle is in tissue at a rig that has never been used."""
    state = StateStore(tmp_path / "state.json").state
    assert state.needle_in_tissue is None
    assert "no state file yet" in state.doubt


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"{",
        b"[]",
        b"null",
        b"\xff\xfe",
        b'{"kind": "labrig-plane", "schema_version": 1}',
        json.dumps({"kind": "labrig-rig-state", "schema_version": 2}).encode(),
        json.dumps({"kind": "labrig-rig-state", "schema_version": 1}).encode(),
        json.dumps(
            {
                "kind": "labrig-rig-state",
                "schema_version": 1,
                "needle_in_tissue": "no",
                "since_run": None,
                "referenced": [],
                "note": "",
            }
        ).encode(),
        json.dumps(
            {
                "kind": "labrig-rig-state",
                "schema_version": 1,
                "needle_in_tissue": False,
                "since_run": None,
                "referenced": "insertion",
                "note": "",
            }
        ).encode(),
    ],
)
def test_a_damaged_file_is_a_doubt_that_is_told(tmp_path: Path, content: bytes) -> None:
    """In doubt a needle is in tissue: a file that cannot be read is never taken to say that none is."""
    path = tmp_path / "state.json"
    path.write_bytes(content)
    state = StateStore(path).state
    assert state.needle_in_tissue is None
    assert state.referenced == ()
    assert "state.json cannot be read" in state.doubt


def test_a_state_that_cannot_be_written_is_an_error(tmp_path: Path) -> None:
    """A needle does not go into tissue on a rig that could not remember it."""
    with pytest.raises(DiskError):
        StateStore(tmp_path / "missing" / "state.json").update(needle_in_tissue=True)
