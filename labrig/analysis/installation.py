"""What a result rests on in a process: the code of labrig, the libraries that compute, and their kernels."""

import hashlib
import json
import platform
from collections.abc import Mapping
from functools import cache
from importlib import metadata

import cv2  # noqa: F401 - what computes is loaded, so that its kernels can be described
import scipy.linalg  # noqa: F401

from labrig import __version__
from labrig.errors import WorkersError
from labrig.record.processor import describe_processor
from labrig.record.source_digest import digest_sources

_COMPUTING = ("numpy", "scipy", "opencv-python-headless", "filterpy", "shapely")


@cache
def describe_installation() -> Mapping[str, str]:
    """Return what must be equal in two processes for their results to agree, by name.

    labrig's version and the SHA-256 of its code, Python's minor version, and the packages that compute.
    """
    return {
        "labrig": __version__,
        "source_sha256": digest_sources(),
        "python": ".".join(platform.python_version_tuple()[:2]),
        **{name: _read_version(name) for name in _COMPUTING},
    }


def describe_kernels() -> Mapping[str, object]:
    """Return what the last digits of a result rest on too, the kernels, as `describe_processor` does."""
    return describe_processor()


def _read_version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"


@cache
def digest_installation() -> str:
    """Return the SHA-256 of what `describe_installation` returns."""
    return hashlib.sha256(json.dumps(describe_installation(), sort_keys=True).encode()).hexdigest()


def require_installation(digest: str) -> None:
    """Refuse to compute for a command whose installation is another one.

    Raises
    ------
    WorkersError
        Names the worker's computer, its version and digest.
    """
    if digest_installation() != digest:
        raise WorkersError(
            f"a worker on {platform.node()} has another installation: labrig {__version__}, code"
            f" {digest_sources()[:12]}, digest {digest_installation()[:12]}, expected {digest[:12]}",
            "install the same labrig and the same packages wherever workers run, and start them anew",
        )
