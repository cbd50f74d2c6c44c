"""Builds the manual as a site when a wheel is made, so that an installed labrig can open it without a network."""

import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from sphinx.cmd.build import build_main


class ManualHook(BuildHookInterface):
    """Puts the site into `labrig/manual/site` of the wheel; an installation in place has the sources alone."""

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
