"""How rooms hand out their names."""

import ast
import importlib
import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOMS = sorted(stub.parent.name for stub in (Path(__file__).parents[1] / "labrig").glob("*/__init__.pyi"))


def _loaded_by(code: str, packages: tuple[str, ...]) -> list[str]:
    """Return which of the packages a new Python has loaded after some code."""
    code += f"\nimport sys, json; print(json.dumps([one for one in {packages!r} if one in sys.modules]))"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
    )
    loaded: list[str] = json.loads(done.stdout)
    return loaded


@pytest.mark.parametrize("room", ROOMS)
def test_every_name_of_a_stub_is_handed_out(room: str) -> None:
    """Each name that a room's stub imports is where the stub says, and `__all__` of the stub says the same names."""
    door = importlib.import_module(f"labrig.{room}")
    assert [name for name in dir(door) if not hasattr(door, name)] == []
    stub = ast.parse(Path(door.__file__ or "").with_suffix(".pyi").read_text(encoding="utf-8"))
    exported = ast.literal_eval(next(one.value for one in stub.body if isinstance(one, ast.Assign)))
    assert sorted(exported) == sorted(dir(door))


@pytest.mark.parametrize(
    ("code", "unneeded"),
    [
        ("from labrig.record import find_runs, tag_run", ("numpy", "pandas", "cv2", "fsspec", "ruamel", "pydantic")),
        ("from labrig.record import check_run, compare_runs", ("pandas", "fsspec")),
        ("from labrig.protocol import protocol_schema", ("numpy", "pandas", "cv2", "scipy")),
        ("from labrig.devices import SystemClock", ("numpy", "cv2", "can", "canopen", "pydantic")),
    ],
)  # fmt: skip
def test_what_is_not_asked_for_is_not_loaded(code: str, unneeded: tuple[str, ...]) -> None:
    """A name brings the packages that it needs, and not those of its neighbours."""
    assert _loaded_by(code, unneeded) == []
