"""The seam between procedures and rigs: a procedure asks its session alone, and each rig answers all of it."""

import ast
from inspect import signature
from pathlib import Path

import pytest

from labrig.devices.replayed.rig import ReplayedRig
from labrig.devices.rig import Rig
from labrig.devices.rig_calls import RigCalls

LABRIG = Path(__file__).parents[2] / "labrig"
BEHIND = {"rig", "recorder", "dialogue"}
CALLS = sorted(name for name, value in vars(RigCalls).items() if callable(value) and not name.startswith("_"))


def reads_behind_a_session(path: Path) -> list[str]:
    """Return where a file reads what stands behind a session."""
    return [
        f"{path.relative_to(LABRIG)}:{node.lineno} {ast.unparse(node)}"
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Attribute)
        and node.attr in BEHIND
        and ast.unparse(node.value).endswith("session")
    ]


def test_procedures_ask_their_session_alone() -> None:
    """No experiment, ours or the example's, reaches through its session to rig, recorder or dialogue."""
    files = [*(LABRIG / "experiments").rglob("*.py"), *(LABRIG / "manual" / "example").rglob("*.py")]
    assert len(files) > 50
    assert [place for path in files for place in reads_behind_a_session(path)] == []


def test_a_reach_behind_a_session_is_found() -> None:
    """The check above can fail."""
    path = LABRIG / "runner" / "conduct.py"
    assert reads_behind_a_session(path)


@pytest.mark.parametrize("name", CALLS)
@pytest.mark.parametrize("rig", [Rig, ReplayedRig])
def test_each_rig_takes_each_call_alike(rig: type[object], name: str) -> None:
    """The same parameters, by name and place, with the same defaults where there are any."""
    ours, interface = signature(getattr(rig, name)), signature(getattr(RigCalls, name))
    assert list(ours.parameters) == list(interface.parameters)
    assert [p.kind for p in ours.parameters.values()] == [p.kind for p in interface.parameters.values()]
