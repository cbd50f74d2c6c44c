"""What numbers were computed with, and how that differs elsewhere."""

from collections.abc import Mapping

import pytest

from labrig.record.provenance import describe_change, describe_processor

HERE = {
    "model": "EPYC", "features": "fma avx2", "numpy": "X86_V2 X86_V3", "opencv": "SSE", "ipp": "off",
    "libm": "glibc 2.36 with FMA", "blas_numpy": "openblas Haswell", "blas_scipy": "openblas Haswell",
}  # fmt: skip


def test_processor_and_kernels_are_described() -> None:
    """Each library is named with its kernels, as text."""
    found = describe_processor()
    assert {"model", "features", "numpy", "opencv", "ipp", "libm", "blas_numpy"} <= found.keys()
    assert all(isinstance(value, str) for value in found.values())
    assert found["model"]
    assert found["libm"].endswith(" FMA")


def test_the_same_kernels_are_no_change() -> None:
    """Here is like here, and what is not known on one side is not compared."""
    assert describe_change(describe_processor(), describe_processor()) == ""
    assert describe_change(HERE, {**HERE, "features": "", "blas_opencv": "Zen"}) == ""
    assert describe_change(None, HERE) == ""


@pytest.mark.parametrize(
    ("other", "change"),
    [
        ({"blas_numpy": "openblas SkylakeX", "blas_scipy": "openblas SkylakeX"},
         "made with blas openblas SkylakeX, and this is blas openblas Haswell"),
        ({"model": "Xeon", "numpy": "X86_V2"},
         "made with model Xeon and numpy X86_V2, and this is model EPYC and numpy X86_V2 X86_V3"),
    ],
)  # fmt: skip
def test_a_change_is_told_in_one_sentence(other: Mapping[str, str], change: str) -> None:
    """It names what differs, once, with both."""
    assert describe_change({**HERE, **other}, HERE) == change
