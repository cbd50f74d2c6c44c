"""protocol: YAML -> frozen, validated protocol, units in the names.

Decided here:

- YAML 1.2 by ruamel.yaml, read from its nodes: `no` is a word; a key that stands twice, tags, merge keys
  and NaN are refused; aliases expand within bounds. A protocol is data, and nothing in it can name code.
- All problems of a file are told at once, each with file, line, column, value, what was expected and a hint; only
  what makes a text no YAML is told alone. The words are taken from the JSON Schema that editors read, so the
  two cannot differ.
- Values are validated in pydantic's strict JSON mode: 40 is a length, "40" and yes are not. Units stand in
  the names and are never converted silently; a hint says what the value would be.
- Rules between values are `Model.conflicts`, told at the key that has to change.
- `dump_yaml` writes every default out: the protocol in a record means the same when defaults have changed.
- A needle, of a protocol or of a scenario, may name a design file (`design_file:`) instead of diameter and radius. The
  numbers are put in when the file is read, so that what is recorded is whole; the name is relative and stays beside the
  folder of the file that names it. `load_design` reads one for whoever needs the radius with its tolerance.
- The rig file and its `world:` section use the same `Model` and the same reader.

An experiment is added by a `Protocol` subclass in `protocols.py` and its name in `load.py`; then
`labrig schema > protocols/protocol.schema.json`.
"""
