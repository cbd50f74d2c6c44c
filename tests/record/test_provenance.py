"""What code ran, with which packages, on which computer, and how numbers differ elsewhere."""

import hashlib
import json
import platform
import shutil
import subprocess
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path

import pytest

import labrig
from labrig.record.provenance import (
    _read_git_state,
    collect_code_diff,
    collect_provenance,
    describe_change,
    describe_processor,
    digest_sources,
)


def test_provenance_names_code_packages_and_computer() -> None:
    """It is JSON, names the versions of what labrig depends on itself, and of the program only the name."""
    found = collect_provenance(["/somewhere/bin/labrig", "run", "a b.yaml"])
    assert json.loads(json.dumps(found)) == found
    assert found["labrig"] == labrig.__version__
    assert found["command_line"] == ["labrig", "run", "a b.yaml"]
    assert found["python"] == platform.python_version()
    packages = found["packages"]
    assert isinstance(packages, dict)
    assert packages["numpy"] == metadata.version("numpy")
    assert {"opencv-python-headless", "scipy", "canopen"} <= packages.keys()
    assert not {"pytest", "ruff"} & packages.keys()


def test_the_digest_is_that_of_a_listing_by_sha256sum(tmp_path: Path) -> None:
    """Anybody can compute it again; what is no code does not count, wherever it stands."""
    code = {"a.py": b"1", "b/page.html.jinja": b"2", "b.py": b"3"}
    for name in (*code, "b/.cache/a.py", "examples/x.svg", "manual/example/y.py", "read.md"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(code.get(name, b"4"))
    listing = "".join(f"{hashlib.sha256(code[name]).hexdigest()}  {name}\n" for name in sorted(code))
    assert digest_sources(tmp_path) == hashlib.sha256(listing.encode()).hexdigest()


@pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")
def test_what_the_code_differs_from_its_commit_can_be_applied(tmp_path: Path) -> None:
    """Changed and new files of Python are in the patch, and git can apply it; .env, keys, links and data are not."""
    tree, identity = tmp_path / "tree", ["-c", "user.name=n", "-c", "user.email=e"]
    (tree / "labrig" / ".cache").mkdir(parents=True)
    (tree / "labrig" / "code.py").write_text("1\n")
    assert _read_git_state(tree) == {"git_commit": None, "git_dirty": None}
    for words in (["init", "-q"], ["add", "."], [*identity, "commit", "-q", "-m", "first"]):
        subprocess.run(["git", "-C", tree, *words], check=True)
    subprocess.run(["git", "clone", "-q", tree, tmp_path / "other"], check=True)
    for name in (
        ".env",
        ".env.py",
        "id_rsa",
        "patients.csv",
        ".cache/code.py",
        "../notes",
        "../../outside.py",
    ):
        (tree / "labrig" / name).write_text("SECRET")
    (tree / "labrig" / "link.py").symlink_to(tmp_path / "outside.py")
    assert collect_code_diff(tree) == b""
    (tree / "labrig" / "code.py").write_text("2\n")
    (tree / "labrig" / "größe.py").write_text("3\n")
    state, diff = _read_git_state(tree), collect_code_diff(tree)
    assert (len(str(state["git_commit"])), state["git_dirty"]) == (40, True)
    subprocess.run(["git", "-C", tmp_path / "other", "apply", "-"], input=diff, check=True)
    copied = {path.name: path.read_text() for path in (tmp_path / "other" / "labrig").iterdir()}
    assert copied == {"code.py": "2\n", "größe.py": "3\n"}


HERE = {
    "model": "EPYC", "features": "fma avx2", "numpy": "X86_V2 X86_V3", "opencv": "SSE", "ipp": "off",
    "libm": "glibc 2.36 with FMA", "blas_numpy": "openblas Haswell", "blas_scipy": "openblas Haswell",
}  # fmt: skip


def test_processor_and_kernels_are_described() -> None:
    """Each library is named with its kernels, as text; what is not known on one side is not compared."""
    found = describe_processor()
    assert {"model", "features", "numpy", "opencv", "ipp", "libm", "blas_numpy"} <= found.keys()
    assert all(isinstance(value, str) for value in found.values())
    assert found["model"]
    assert found["libm"].endswith(" FMA")
    assert describe_change(found, found) == ""
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
