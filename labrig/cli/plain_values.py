"""Values of the command line that need no validator: those that were not given, and plain text.

typer makes a validator of pydantic for each option of a command, given or not, and imports pydantic for it: half of the
start-up time of `labrig runs`.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any


def spare_validators(params: Sequence[Any]) -> list[Any]:
    """Return the parameters of a command, as typer makes them, which now take such values as they are."""
    for param in params:
        if "process_value" not in vars(param):
            param.process_value = partial(_process, param, param.process_value)
    return list(params)


def _process(param: Any, validate: Callable[[Any, Any], Any], context: Any, value: Any) -> Any:
    """Return the value of a parameter, as its own `process_value` does."""
    is_absent = value is None and not param.required
    if not is_absent and not _is_plain_text(param, value):
        return validate(context, value)
    taken = () if is_absent and (param.multiple or param.nargs == -1) else value
    return taken if param.callback is None else param.callback(context, param, taken)


def _is_plain_text(param: Any, value: Any) -> bool:
    """Return whether a text was given for a text."""
    described = getattr(param, "type_descriptor", None)
    is_text = (
        described is not None and described.annotation is str and described.parameter_info.parser is None
    )
    return is_text and isinstance(value, str)
