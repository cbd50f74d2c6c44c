"""Packages as pip leaves them in a folder: metadata with entry points, and a module where a package has one."""

from pathlib import Path

from labrig.plugins import find_plugins


def install_package(
    site: Path, package: str, entry_points: str, module: str = "", code: str = "", version: str = "1.5"
) -> None:
    """Install a package into a folder that is, or will be, on the path of modules."""
    info = site / f"{package.replace('-', '_')}-{version}.dist-info"
    info.mkdir(parents=True)
    metadata = f"Metadata-Version: 2.1\nName: {package}\nVersion: {version}\n"
    (info / "METADATA").write_text(metadata, encoding="utf-8")
    (info / "entry_points.txt").write_text(entry_points, encoding="utf-8")
    if module:
        (site / f"{module}.py").write_text(code, encoding="utf-8")
    find_plugins.cache_clear()
