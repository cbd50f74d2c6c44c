"""The seam between procedures and rigs: a procedure asks its session alone."""

import ast
from pathlib import Path

LABRIG = Path(__file__).parents[2] / "labrig"
BEHIND = {"rig", "recorder", "dialogue"}


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
    assert reads_behind_a_session(LABRIG / "runner" / "conduct.py"), "the check can fail"
    assert [place for path in files for place in reads_behind_a_session(path)] == []
