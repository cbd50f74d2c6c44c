"""What labrig was installed as. It imports nothing of labrig: a report of an import that failed states the version."""

from contextlib import suppress
from importlib.metadata import Distribution, PackageNotFoundError, distribution

OWN_DISTRIBUTIONS = ("labrig", "labrig-core")
"""The same files; the second is installed with fewer packages."""


def find_own_distribution() -> Distribution:
    """Return the distribution that this code was installed as.

    Raises
    ------
    PackageNotFoundError
        When it is not installed.
    """
    for name in OWN_DISTRIBUTIONS:
        with suppress(PackageNotFoundError):
            return distribution(name)
    raise PackageNotFoundError(OWN_DISTRIBUTIONS[0])
