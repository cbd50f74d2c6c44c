"""Builds the manual as a site when a wheel is made, and packs the examples of a lab folder."""

import sys
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from sphinx.cmd.build import build_main


class ManualHook(BuildHookInterface[Any]):
    """Puts site and examples into a wheel; an installation in place has the sources alone."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Build it by Sphinx, in which a warning, such as a link that leads nowhere, is an error."""
        if version == "editable":
            return
        self._folder = tempfile.TemporaryDirectory()  # gone with this hook, after the wheel is packed
        site = Path(self._folder.name) / "site"
        source = str(Path(self.root) / "labrig" / "manual")
        if build_main(["-q", "-W", "-b", "html", "-d", str(site.with_name("read")), source, str(site)]):
            raise RuntimeError("Sphinx could not build the manual")
        build_data["force_include"][str(site)] = "labrig/manual/site"
        sys.path.insert(0, self.root)
        from labrig.lab import list_examples

        for file in list_examples(Path(self.root)):
            build_data["force_include"][str(file)] = (
                f"labrig/examples/{file.relative_to(self.root).as_posix()}"
            )
