"""How a room hands out its names: each is imported when it is first asked for, and not before.

`labrig runs` lists thousands of runs and needs no pandas for it, nor `labrig schema` a bus. So that such a room has one
face all the same, its names stand as plain imports in a stub, `__init__.pyi`: type checkers and editors read that, and
so does this module while the program runs (`__getattr__` of a module, PEP 562). There is no second list to keep.
"""

import ast
import importlib
import sys
from collections.abc import Callable, Iterator
from pathlib import Path


def open_door(room: str, face: str) -> tuple[Callable[[str], object], Callable[[], list[str]], list[str]]:
    """Return the `__getattr__`, the `__dir__` and the `__all__` of a room.

    Parameters
    ----------
    room : str
        Its `__name__`.
    face : str
        Its `__file__`; the stub stands beside it.
    """
    places = dict(_imports(Path(face).with_suffix(".pyi")))

    def get(name: str) -> object:
        if name not in places:
            raise AttributeError(f"module {room!r} has no attribute {name!r}")
        module, own_name = places[name]
        value = getattr(importlib.import_module(module), own_name)
        setattr(sys.modules[room], name, value)  # asked for once
        return value

    return get, lambda: sorted(places), list(places)


def _imports(stub: Path) -> Iterator[tuple[str, tuple[str, str]]]:
    """Give each name that a stub imports: the module that it is in, and its name there."""
    for statement in ast.parse(stub.read_bytes()).body:
        if isinstance(statement, ast.ImportFrom) and statement.module is not None:
            for one in statement.names:
                yield one.asname or one.name, (statement.module, one.name)
