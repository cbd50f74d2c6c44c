"""Result of a check of a device, a calibration or the computer."""

from dataclasses import dataclass
from enum import StrEnum

from labrig.errors import LabrigError


class CheckStatus(StrEnum):
    """Outcome of a check."""

    PASS = "PASS"  # noqa: S105 - no password
    WARN = "WARN"
    FAIL = "FAIL"


@dataclass(frozen=True)
class CheckResult:
    """One check: its subject, its outcome, what was found, and what to do about it."""

    check: str
    status: CheckStatus
    value: str
    solution: str = ""


def passed(check: str, value: str) -> CheckResult:
    """Return the result of a check that found what it should."""
    return CheckResult(check, CheckStatus.PASS, value)


def warned(check: str, value: str, solution: str) -> CheckResult:
    """Return the result of a check that found something to look at."""
    return CheckResult(check, CheckStatus.WARN, value, solution)


def failed(check: str, error: LabrigError) -> CheckResult:
    """Return the result of a check that ended with an error."""
    return CheckResult(check, CheckStatus.FAIL, error.message, error.hint)
