"""The reference of a kind of YAML file, as Markdown: every key of its JSON Schema, section by section."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field

from labrig.protocol.formatting import Plain, show
from labrig.protocol.schema import JsonSchema, SchemaView

_UNIT = re.compile(r" ?\[([^\[\]]*[^\d\s.,\[\]][^\[\]]*)\](?=[.;,: ]|$)")
_WRITTEN = {"Can": "CAN", "Cia402": "CiA 402", "Epos2": "EPOS2", "Uvc": "UVC"}
"""Words of model names that are written otherwise."""

_HEAD = "| key | value | unit | default | meaning |\n|---|---|---|---|---|"


@dataclass
class _Section:
    """A section of the file: its schema, and the keys at which it stands."""

    view: SchemaView
    places: dict[str, None] = field(default_factory=dict)


def write_reference(schema: JsonSchema, title: str, introduction: str) -> str:
    """Return the reference as Markdown: a table for each section, in the order in which sections are met.

    Parameters
    ----------
    schema : dict
        JSON Schema of the kind of file, as `model_schema` makes it.
    title, introduction : str
        Heading of the page, and the paragraph below it, as Markdown.
    """
    root = SchemaView.of(schema)
    kinds = {tag: root.kind(tag) for tag in root.tags} or {"": root}
    sections: dict[str, _Section] = {}
    for kind, view in kinds.items():
        _collect(view, f"{kind}: " if kind else "", sections)
    lines = [f"# {title}", "", introduction, ""]
    for kind, view in kinds.items():
        heading = f"`{root.tag_key}: {kind}`" if kind else "The file"
        lines += [f"## {heading}", "", escape(view.description), "", *_write_keys(view)]
    for name, section in sections.items():
        places = ", ".join(f"`{place}`" for place in section.places)
        lines += [f"## {name}", "", f"At {places}. {escape(_describe_model(section.view))}", ""]
        lines += _write_keys(section.view)
    return "\n".join(lines)


def escape(text: str) -> str:
    """Return a text in which no character but the backtick is markup, also in a table."""
    plain = r"([\\*_\[\]<>|&])"
    parts = re.split(r"(`[^`]*`)", " ".join(text.split()))
    return "".join(
        part.replace("|", "\\|") if part.startswith("`") else re.sub(plain, r"\\\1", part) for part in parts
    )


def _collect(view: SchemaView, kind: str, sections: dict[str, _Section], above: str = "") -> None:
    """Enter the sections below a section, each once, with every key that leads to it."""
    for key in view.keys:
        for inner in _find_sections(_child(view, key)):
            place = f"{above}{key}"
            section = sections.setdefault(_name(inner), _Section(inner))
            first = not section.places
            section.places[place] = None
            if first:
                _collect(inner, kind, sections, f"{place}.")


def _child(view: SchemaView, key: str) -> SchemaView:
    found = view.child(key)
    assert found is not None, key
    return found


def _find_sections(view: SchemaView) -> Iterator[SchemaView]:
    """Yield the sections that stand at a key: itself, its kinds, or the entries of a list or mapping."""
    if view.keys:
        yield view
        return
    for option in _find_options(view):
        yield from _find_sections(option)


def _find_options(view: SchemaView) -> Iterator[SchemaView]:
    """Yield what a value may be or hold."""
    patterns = view.node.get("patternProperties")
    entries = [view.node.get("items"), view.node.get("additionalProperties")]
    entries += list(patterns.values()) if isinstance(patterns, dict) else []
    for word in ("anyOf", "oneOf", "prefixItems"):
        listed = view.node.get(word)
        entries += listed if isinstance(listed, list) else []
    for entry in entries:
        if isinstance(entry, dict):
            yield view.follow(entry)


def _name(section: SchemaView) -> str:
    """Return the name of a section's model as words: Analysis window."""
    first, *others = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", str(section.node["title"])).split()
    words = [_WRITTEN.get(first, first), *(_WRITTEN.get(word, word.lower()) for word in others)]
    return " ".join(words).removesuffix(" description")


def _describe_model(section: SchemaView) -> str:
    """Return what a section is, whatever key it stands at."""
    definition = section.definitions[str(section.node["title"])]
    assert isinstance(definition, dict)
    return str(definition.get("description", ""))


def _write_keys(view: SchemaView) -> list[str]:
    """Return the table of the keys of a section."""
    required = view.node.get("required")
    needed = required if isinstance(required, list) else []
    return [_HEAD, *(_write_key(key, _child(view, key), key in needed) for key in view.keys), ""]


def _write_key(key: str, view: SchemaView, required: bool) -> str:
    unit = _UNIT.search(view.description)
    meaning = _UNIT.sub("", view.description, count=1)
    default = "required" if required else _show_default(view.node)
    cells = (f"`{key}`", _describe(view), escape(unit[1]) if unit else "", default, escape(meaning))
    return f"| {' | '.join(cells)} |"


def _show_default(node: object) -> str:
    assert isinstance(node, dict)
    if "default" not in node:
        return "its own defaults"
    value: Plain = node["default"]
    return code("null" if value is None else show(value))


def code(text: str) -> str:
    """Return a text as code in a line, also in a table."""
    plain = " ".join(text.replace("`", "'").split())
    return f"`{plain}`".replace("|", "\\|")


def _describe(view: SchemaView) -> str:
    """Return the type and limits of a value in words, with a link to each section that it may be."""
    names = dict.fromkeys(_name(section) for section in _find_sections(view))
    if not names:
        return escape(view.describe())
    links = " or ".join(f"[{name}](#{name.lower().replace(' ', '-')})" for name in names)
    noun = {"array": "a list, each ", "object": "" if view.keys else "by name, each "}
    return f"{noun.get(str(view.node.get('type')), '')}{links}{' or null' * bool(view.node.get('nullable'))}"
