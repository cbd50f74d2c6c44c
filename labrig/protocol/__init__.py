"""protocol: YAML -> frozen, validated protocol, units in the names.

Decided here:

- ruamel.yaml composes YAML 1.2 and reads its scalars, and its nodes are joined here: `no` is a word, a date is a text;
  duplicate keys, tags, merge keys and NaN are refused; aliases expand within bounds. A protocol is data, and nothing in
  it can name code.
- All problems of a file are reported at once, each with file, line, column, value, what was expected and a hint; only
  a syntax error is reported alone. What a key is comes from the JSON Schema that editors read.
- Values are validated in pydantic's strict JSON mode: 40 is a length, "40" and yes are not. Units are part of the
  names and are never converted.
- Rules between values are in `Model.conflicts` and are reported at the key that has to change.
- `dump_yaml` writes out every default, so the protocol in a record keeps its meaning when defaults change.
- The needle of a protocol may name a design file (`design_file:`) instead of diameter and radius. The
  numbers are filled in when the file is read, so that the record is complete. The name is relative, and the file must
  be below the parent of the folder that holds the protocol.
- A gel may name a specimen (`specimen_file:`). What its file says is filled in too, and the protocol may not contradict
  it. The tracks of earlier runs are put in by `labrig run` and `labrig check` (`put_tracks`), so that what a
  run was refused or allowed by, and where it repeats a hole, follows from its record alone.
- The rig file and its `world:` section use the same `Model` and the same reader.

This room knows no experiment. Each experiment's folder holds its own model, a subclass of `ExperimentProtocol`, and
`load_protocol` is handed all of them by name. After a change of a model, run
`labrig init .`.
"""
