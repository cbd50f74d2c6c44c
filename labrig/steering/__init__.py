"""steering: planner, tip estimator and the step that joins them, as pure functions."""

import importlib
from typing import Any

_DOCUMENTED = {"estimate_tip_poses": "estimator", "plan_path": "planner"}


def __getattr__(name: str) -> Any:
    """Import planner or estimator on first use: a protocol that takes its defaults from this room needs neither."""
    if name in _DOCUMENTED:
        return getattr(importlib.import_module(f"labrig.steering.{_DOCUMENTED[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
