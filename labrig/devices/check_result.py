"""What a check of a device, a calibration or the computer came to."""

from dataclasses import dataclass
from enum import StrEnum

from labrig.errors import LabrigError


class CheckStatus(StrEnum):
    """How a check came out."""

    PASS = "PASS"  # noqa: S105 - no password
    WARN = "WARN"
    FAIL = "FAIL"


@dataclass(frozen=True)
class CheckResult:
    """One check: what was looked at, how it came out, what was found, and what to do about it."""

    check: str
    status: CheckStatus
    value: str
    solution: str = ""


def failed(check: str, error: LabrigError) -> CheckResult:
    """Return the result of a check that an error has ended."""
    return CheckResult(check, CheckStatus.FAIL, error.message, error.hint)
