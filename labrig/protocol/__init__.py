"""protocol: YAML -> frozen, validated protocol, units in the names.

Decided here:

- YAML 1.2 by ruamel.yaml, read through its events: `no` is a word; a key that stands twice, tags, merge keys
  and NaN are refused; aliases expand within bounds. A protocol is data, and nothing in it can name code.
- All problems of a file are told at once, each with file, line, column, value, what was expected and a hint.
  The words are taken from the JSON Schema that editors read, so the two cannot differ.
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

from labrig.protocol.design_file import Basis, NeedleDesign, TubeSection, load_design
from labrig.protocol.insertion import (
    Advance,
    InsertionObstacle,
    InsertionProtocol,
    Place,
    Planner,
    RollZeroProtocol,
    RollZeroSteps,
    Target,
)
from labrig.protocol.load import AnyProtocol, load_protocol, load_scenario, parse_protocol, protocol_schema
from labrig.protocol.model import (
    Conflict,
    Direction,
    Line,
    Model,
    Name,
    NonNegativeMm,
    Notes,
    PixelUv,
    PositiveMm,
    Seed,
    SpeedMmS,
)
from labrig.protocol.protocols import (
    AnalysisWindow,
    Board,
    CameraCalibrationProtocol,
    DesignProtocol,
    DesignTolerances,
    GelAbove,
    GraphPaper,
    ImportedNeedle,
    ImportProtocol,
    Insertion,
    MeasuredNeedle,
    Needle,
    NeedleDesignSection,
    Scale,
    Sheath,
    Specimen,
    SteerabilityProtocol,
)
from labrig.protocol.scenario import Scenario
from labrig.protocol.schema import JsonSchema, model_schema, schema_text
from labrig.protocol.tree import Plain
from labrig.protocol.yaml_file import (
    dump_yaml,
    load_yaml_model,
    model_of_values,
    parse_yaml_model,
    yaml_values,
)

__all__ = [
    "Advance",
    "AnalysisWindow",
    "AnyProtocol",
    "Basis",
    "Board",
    "CameraCalibrationProtocol",
    "Conflict",
    "DesignProtocol",
    "DesignTolerances",
    "Direction",
    "GelAbove",
    "GraphPaper",
    "ImportProtocol",
    "ImportedNeedle",
    "Insertion",
    "InsertionObstacle",
    "InsertionProtocol",
    "JsonSchema",
    "Line",
    "MeasuredNeedle",
    "Model",
    "Name",
    "Needle",
    "NeedleDesign",
    "NeedleDesignSection",
    "NonNegativeMm",
    "Notes",
    "PixelUv",
    "Place",
    "Plain",
    "Planner",
    "PositiveMm",
    "RollZeroProtocol",
    "RollZeroSteps",
    "Scale",
    "Scenario",
    "Seed",
    "Sheath",
    "Specimen",
    "SpeedMmS",
    "SteerabilityProtocol",
    "Target",
    "TubeSection",
    "dump_yaml",
    "load_design",
    "load_protocol",
    "load_scenario",
    "load_yaml_model",
    "model_of_values",
    "model_schema",
    "parse_protocol",
    "parse_yaml_model",
    "protocol_schema",
    "schema_text",
    "yaml_values",
]
