"""Builds the distributions: `labrig`, and `labrig-core` from the same files with fewer dependencies.

make wheels
"""

import os
import shutil
import subprocess
import sys
import tarfile
import tomllib
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import tomlkit
from packaging.requirements import Requirement

ROOT = Path(__file__).parents[1]
QUIET = {
    name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "LABRIG", "COV"))
}


def build(source: Path, folder: Path, *kinds: str) -> None:
    """Build distributions without the network, as `pip wheel` would fetch the build backend first, and without git."""
    targets = [word for kind in kinds for word in ("-t", kind)]
    command = [sys.executable, "-m", "hatchling", "build", *targets, "-d", str(folder)]
    quiet = {**QUIET, "PATH": ""}
    subprocess.run(command, cwd=source, check=True, env=quiet, timeout=300)


def build_both(folder: Path) -> None:
    """Build wheel and sdist of labrig, then those of labrig-core from labrig's sdist."""
    build(ROOT, folder, "wheel", "sdist")
    (sdist,) = folder.glob("labrig-*.tar.gz")
    with TemporaryDirectory() as unpacked:
        with tarfile.open(sdist) as packed:
            packed.extraction_filter = getattr(tarfile, "data_filter", None)  # Python 3.11.2 has none
            packed.extractall(unpacked)
        (source,) = Path(unpacked).iterdir()
        (source / "PKG-INFO").unlink()  # labrig's; hatchling writes another one beside it
        file = source / "pyproject.toml"
        described = describe_core(tomllib.loads(file.read_text(encoding="utf-8")))
        file.write_text(tomlkit.dumps(described), encoding="utf-8")
        build(source, folder, "wheel", "sdist")


def describe_core(described: dict[str, Any]) -> dict[str, Any]:
    """Return the project file of labrig-core, from labrig's."""
    project, left_out = described["project"], described["tool"]["labrig"]["core-leaves-out"]
    full = [text for text in project["dependencies"] if Requirement(text).name in left_out]
    core = {
        "name": "labrig-core",
        "dependencies": [text for text in project["dependencies"] if text not in full],
        "optional-dependencies": {**project["optional-dependencies"], "full": full},
    }
    return {**described, "project": {**project, **core}}


if __name__ == "__main__":
    out = Path(sys.argv[1])
    shutil.rmtree(out, ignore_errors=True)
    build_both(out.absolute())
