"""The room's public face and its weight."""

import subprocess
import sys

import labrig.protocol

HEAVY = ("cv2", "numpy", "pandas", "scipy", "matplotlib", "rerun", "can", "canopen", "typer", "jinja2")


def test_importing_the_room_loads_nothing_heavy():
    """`labrig schema` and `labrig check` start fast: pydantic and ruamel.yaml are all that is loaded."""
    code = f"import sys, labrig.protocol; print([name for name in {HEAVY!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_public_face_is_what_the_room_lists():
    """Every listed name exists, and the list is in order."""
    assert labrig.protocol.__all__ == sorted(labrig.protocol.__all__)
    assert all(hasattr(labrig.protocol, name) for name in labrig.protocol.__all__)
