"""What numbers were computed with: the processor, and the kernels that libraries have chosen for it.

numpy, OpenCV with IPP, BLAS and the C library hold several versions of their loops, and take at load time those that
the processor runs best. They round differently, so the last digits of a result rest on them.
"""

import math
import os
import platform
import sys
from collections.abc import Mapping
from pathlib import Path

from threadpoolctl import threadpool_info

_CPUINFO = Path("/proc/cpuinfo")
# The names of features that kernels are chosen by begin so, on x86-64 and on 64-bit ARM.
_FEATURES = ("sse4", "avx", "fma", "asimd", "sve")
# The exact value ends so near the middle of two doubles that glibc rounds it up where it uses FMA, and down elsewhere.
_EXP_OF, _EXP_WITH_FMA = 0.5768, float.fromhex("0x1.c7c3da95bb8b9p+0")
_WORDS = {"model": "", "numpy": "numpy ", "opencv": "OpenCV ", "ipp": "IPP ", "libm": ""}
_LISTS = frozenset({"numpy", "opencv"})
_BLAS = {"openblas": "OpenBLAS"}


def describe_processor() -> dict[str, str | None]:
    """Return the processor and the kernels in use in this process, as JSON.

    Nothing is loaded for it: what belongs to a library that is not loaded is None, or missing for BLAS.

    Returns
    -------
    dict
        `model` (name of the processor), `features` (those of it that kernels are chosen by, as the operating system
        calls them), `numpy` and `opencv` (the features for which they use kernels of their own), `ipp` (its kernels and
        version, or `off`), `libm` (the C library, and whether it computes with FMA), and `blas_LIBRARY` for each BLAS,
        such as `blas_numpy: OpenBLAS SkylakeX`.
    """
    return {**_read_cpuinfo(), "numpy": _name_numpy(), **_name_opencv(), "libm": _name_libm(), **_name_blas()}


def describe_change(recorded: object, now: object) -> str:
    """Return in one sentence how two descriptions differ; empty if they do not.

    Parameters
    ----------
    recorded, now : object
        As from `describe_processor`. What one of them does not hold is not compared; nor are `features`, since kernels
        tell which of them were used.

    Returns
    -------
    str
        Such as "made with OpenBLAS SkylakeX, and this is OpenBLAS Haswell".
    """
    if not isinstance(recorded, Mapping) or not isinstance(now, Mapping):
        return ""
    pairs = [
        _tell_apart(key, recorded[key], now[key])
        for key in recorded
        if key != "features" and _differ(recorded[key], now.get(key))
    ]
    if not pairs:
        return ""
    was, here = (" and ".join(dict.fromkeys(side)) for side in zip(*pairs, strict=True))
    return f"made with {was}, and this is {here}"


def _differ(recorded: object, now: object) -> bool:
    return isinstance(recorded, str) and isinstance(now, str) and recorded != now


def _tell_apart(key: str, recorded: str, now: str) -> tuple[str, str]:
    words = _WORDS.get(key, "")
    if key not in _LISTS:
        return words + recorded, words + now
    before, after = (
        " ".join(name for name in ours.split() if name not in others.split())
        for ours, others in ((recorded, now), (now, recorded))
    )
    return words + (before or f"without {after}"), words + (after or f"without {before}")


def _read_cpuinfo() -> dict[str, str | None]:
    """Return name and features of the first processor; of ARM processors the system tells no name."""
    known: dict[str, str] = {}
    if _CPUINFO.exists():
        for line in _CPUINFO.read_text(encoding="utf-8", errors="replace").splitlines():
            key, _, value = line.partition(":")
            known.setdefault(key.strip(), value.strip())
    flags = (known.get("flags") or known.get("Features") or "").split()
    return {
        "model": known.get("model name", platform.machine()),
        "features": " ".join(flag for flag in flags if flag.startswith(_FEATURES)) or None,
    }


def _name_numpy() -> str | None:
    numpy = sys.modules.get("numpy")
    if numpy is None:
        return None
    return " ".join(numpy.show_config(mode="dicts").get("SIMD Extensions", {}).get("found", ()))


def _name_opencv() -> dict[str, str | None]:
    cv2 = sys.modules.get("cv2")
    if cv2 is None:
        return {"opencv": None, "ipp": None}
    # A feature has a star if kernels are chosen by it, and a question mark if they are not chosen here.
    names = [name.removeprefix("*") for name in cv2.getCPUFeaturesLine().split() if not name.endswith("?")]
    version = cv2.ipp.getIppVersion().removeprefix("ippIP ").partition(" (-)")[0]
    return {"opencv": " ".join(names), "ipp": version if cv2.ipp.useIPP() else "off"}


def _name_libm() -> str:
    """Return the C library, and whether its functions use FMA, by a value that they round otherwise then.

    So a restriction by GLIBC_TUNABLES is told too, if it has an effect.
    """
    version = os.confstr("CS_GNU_LIBC_VERSION") if "CS_GNU_LIBC_VERSION" in os.confstr_names else None
    return f"{version or 'libm'} {'with' if math.exp(_EXP_OF) == _EXP_WITH_FMA else 'without'} FMA"


def _name_blas() -> dict[str, str]:
    """Return the kernels of each BLAS that is loaded, by the package whose wheel it came with, or by its folder."""
    return {
        f"blas_{Path(str(found['filepath'])).parent.name.removesuffix('.libs')}": (
            f"{_BLAS.get(found['internal_api'], found['internal_api'])}"
            f" {found.get('architecture') or found.get('version')}"
        )
        for found in sorted(threadpool_info(), key=lambda found: str(found["filepath"]))
        if found["user_api"] == "blas"
    }
