"""What numbers were computed with, and how that differs elsewhere."""

import json
import subprocess
import sys

import pytest

from labrig.record.processor import describe_change, describe_processor

_DESCRIBE = """
import json, numpy, scipy.linalg, cv2
from labrig.record.processor import describe_processor
print(json.dumps(describe_processor()))
"""
HERE = {
    "model": "EPYC", "features": "fma avx2", "numpy": "X86_V2 X86_V3", "opencv": "SSE", "ipp": "off",
    "libm": "glibc 2.36 with FMA", "blas_numpy": "OpenBLAS Haswell", "blas_scipy": "OpenBLAS Haswell",
}  # fmt: skip


def test_processor_and_kernels_are_described() -> None:
    """Each library that is loaded is named with its kernels, and all of it is JSON."""
    done = subprocess.run([sys.executable, "-c", _DESCRIBE], capture_output=True, text=True, check=True)
    found = json.loads(done.stdout)
    assert found["model"]
    assert found["libm"]
    assert {"numpy", "opencv"} <= found.keys()  # their kernels; none where all are switched off
    assert found["ipp"]
    assert found["blas_numpy"]


def test_nothing_is_loaded_to_be_described() -> None:
    """Of a library that is not loaded nothing is known."""
    program = (
        "import sys; from labrig.record.processor import describe_processor; found = describe_processor();"
        "assert not {'numpy', 'cv2', 'scipy'} & sys.modules.keys();"
        "assert (found['numpy'], found['opencv'], found['ipp']) == (None, None, None)"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


def test_the_same_kernels_are_no_change() -> None:
    """Here is like here, and what is not known on one side is not compared."""
    assert describe_change(describe_processor(), describe_processor()) == ""
    assert describe_change({**HERE, "opencv": None}, {**HERE, "ipp": None, "blas_opencv": "Zen"}) == ""
    assert describe_change(None, HERE) == ""


@pytest.mark.parametrize(
    ("other", "change"),
    [
        (
            {"blas_numpy": "OpenBLAS SkylakeX", "blas_scipy": "OpenBLAS SkylakeX"},
            "made with OpenBLAS SkylakeX, and this is OpenBLAS Haswell",
        ),
        ({"numpy": "X86_V2"}, "made with numpy without X86_V3, and this is numpy X86_V3"),
        ({"numpy": "NEON"}, "made with numpy NEON, and this is numpy X86_V2 X86_V3"),
        (
            {"ipp": "AVX2 (l9) 2026.0.0", "libm": "glibc 2.36 without FMA"},
            "made with IPP AVX2 (l9) 2026.0.0 and glibc 2.36 without FMA, and this is IPP off and glibc 2.36 with FMA",
        ),
        ({"model": "Xeon"}, "made with Xeon, and this is EPYC"),
    ],
)
def test_a_change_is_told_in_one_sentence(other: dict[str, object], change: str) -> None:
    """It names what differs, once, with both."""
    assert describe_change({**HERE, **other}, HERE) == change
