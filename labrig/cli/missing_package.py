"""Packages that labrig is installed with and `labrig-core` is not, and extras: a command that needs one says so."""

from importlib.util import find_spec

from packaging.requirements import Requirement

from labrig.distribution import find_own_distribution
from labrig.errors import InputError


def require_package(module: str, package: str, what: str) -> None:
    """Refuse what needs a package that is not installed.

    Parameters
    ----------
    module : str
        The module of the package, which is not imported.
    package : str
        Its name, as labrig's dependencies or extras have it.
    what : str
        What needs it, as the subject of a sentence.

    Raises
    ------
    InputError
        With the command that installs a version that fits.
    """
    if find_spec(module) is None:
        raise InputError(
            f"{what} needs the package {package}, which is not installed",
            f"pip install '{_find_requirement(package)}'",
        )


def _find_requirement(package: str) -> str:
    """Return the versions of a package that fit, with its extras, in the form that pip takes."""
    needed = (Requirement(text) for text in find_own_distribution().requires or ())
    found = next((found for found in needed if found.name == package), Requirement(package))
    extras = f"[{','.join(sorted(found.extras))}]" if found.extras else ""
    return f"{found.name}{extras}{found.specifier}"
