"""Environments that make libraries take other kernels than those that they choose for this processor."""

from collections.abc import Mapping
from dataclasses import dataclass

from labrig.record.provenance import describe_processor

DEFAULT = "default"
_BLAS = "OPENBLAS_CORETYPE"
_NUMPY = "NPY_DISABLE_CPU_FEATURES"
_OPENCV = "OPENCV_CPU_DISABLE"
_IPP = "OPENCV_IPP"
# glibc calls its features so from 2.33 on, and ..._Usable before; it passes over names that it does not know.
_GLIBC = {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX2_Usable,-FMA_Usable"}
# Sums do not depend on how they are shared among threads; OpenCV does not warn of what is switched off.
_ALWAYS = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "OPENCV_LOG_LEVEL": "ERROR"}


@dataclass(frozen=True)
class Environment:
    """Variables under which kernels are chosen, and a short name."""

    name: str
    variables: Mapping[str, str]


def list_environments() -> tuple[Environment, ...]:
    """Return the environments, the default first; of features, they name those of this processor, as numpy demands."""
    found = describe_processor()
    numpy = str(found["numpy"]).split()
    opencv = [name for name in str(found["opencv"]).split() if name.startswith("AVX512")]
    switches = {
        "BLAS": {_BLAS: "Nehalem"},
        "numpy": {_NUMPY: " ".join(numpy)},
        "OpenCV": {_OPENCV: ",".join(["AVX2", "FMA3", *opencv])},
        "IPP": {_IPP: "disabled"},
        "libm": _GLIBC,
    }
    single = [Environment(name, {**_ALWAYS, **variables}) for name, variables in switches.items()]
    everything = {name: value for variables in switches.values() for name, value in variables.items()}
    return (
        Environment(DEFAULT, _ALWAYS),
        *single,
        *_without_avx512(numpy, opencv, str(found["features"])),
        Environment("all at once", {**_ALWAYS, **everything}),
    )


def _without_avx512(numpy: list[str], opencv: list[str], features: str) -> tuple[Environment, ...]:
    """Return what a processor with AVX2 alone would choose; nothing if this one is such."""
    if "avx512f" not in features.split():
        return ()
    large = [name for name in numpy if name == "X86_V4" or name.startswith("AVX512")]
    variables = {_BLAS: "Haswell", _NUMPY: " ".join(large), _OPENCV: ",".join(opencv), _IPP: "avx2"}
    return (Environment("no AVX-512", {**_ALWAYS, **variables}),)
