"""Builds the manual by Sphinx: `make manual`, and when a wheel is made (build_hook.py)."""

import json
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

project = "labrig"
extensions = ["myst_parser"]
exclude_patterns = ["example", "site"]
myst_heading_anchors = 4
smartquotes = False  # an option keeps its two dashes
html_theme = "alabaster"
html_theme_options = {"page_width": "72rem"}
html_copy_source = False

_SCHEMAS = {
    "Protocol": "protocols/protocol.schema.json",
    "Rig": "calibration/rig.schema.json",
    "Campaign": "protocols/campaign.schema.json",
}


def setup(app: Any) -> None:
    """Fill the pages of which the source holds the heading alone."""
    app.connect("source-read", _fill)


def _fill(_app: Any, name: str, source: list[str]) -> None:
    """Append to a page what is generated; `source` is its text, in a list that Sphinx reads again."""
    if name == "reference/commands":
        source[0] += _describe_commands()
    elif name == "reference/keys":
        source[0] += "".join(_describe_keys(title, ROOT / place) for title, place in _SCHEMAS.items())


def _describe_commands() -> str:
    """Return arguments, options and help of every command, as the library of the command line writes them."""
    import typer
    from typer.cli import get_docs_for_click
    from typer.main import get_command

    from labrig.cli.main import app

    command = get_command(app)
    text = get_docs_for_click(obj=command, ctx=typer.Context(command), name="labrig")
    return str(text).partition("## ")[2].join(("\n## ", ""))


def _describe_keys(title: str, file: Path) -> str:
    """Return a table of the keys of each section of a kind of YAML file."""
    schema = json.loads(file.read_text(encoding="utf-8"))
    lines, sections = [f"\n## {title} files\n"], {"": schema, **schema["$defs"]}
    holders = [(of, key, str(at)) for of in sections.values() for key, at in of.get("properties", {}).items()]
    for name, section in sections.items():
        if keys := section.get("properties"):
            # A file goes by its experiment, a section by the keys that hold it, and the files that do.
            held = [(of, key) for of, key, at in holders if f"'#/$defs/{name}'" in at]
            title = ", ".join(sorted({key for _, key in held})) or _find_experiment(section) or "The file"
            files = sorted({_find_experiment(of) for of, _ in held} - {""})
            title += "".join(f" ({file})" for file in files)
            lines += [f"\n### {title}\n", section.get("description", ""), ""]
            lines += ["| key | default | meaning |", "|---|---|---|"]
            lines += [_describe_key(key, value, section.get("required", [])) for key, value in keys.items()]
    return "\n".join(lines) + "\n"


def _find_experiment(section: dict[str, Any]) -> str:
    return str(section.get("properties", {}).get("experiment", {}).get("const", ""))


def _describe_key(key: str, value: dict[str, Any], needed: list[str]) -> str:
    default = f"`{json.dumps(value['default'])}`" if "default" in value else "required" * (key in needed)
    cells = f"`{key}`", default, value.get("description", f"see `{key}:`")
    told = (cell.replace("|", "\\|").replace("<", "&lt;").replace("\n", " ") for cell in cells)
    return f"| {' | '.join(told)} |"
