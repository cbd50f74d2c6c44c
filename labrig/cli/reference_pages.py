"""The pages of the manual that are generated when they are read: protocol, campaign and rig files, and the commands."""

import json
from typing import Any

from labrig.cli.init import make_schemas
from labrig.report.manual import ManualPage

_FOOT = "`labrig init` writes the same as JSON Schema, which editors use to complete and check such files."


def _read(name: str) -> Any:
    return json.loads(make_schemas()[f"{name}.schema.json"])


def _write_protocol_reference() -> str:
    from labrig.protocol.reference import write_reference

    said = "A protocol names its experiment; the other keys follow from that. " + _FOOT
    return write_reference(_read("protocols/protocol"), _PROTOCOL, said)


def _write_rig_reference() -> str:
    from labrig.protocol.reference import write_reference

    said = "A rig file says how the bench is built. " + _FOOT
    return write_reference(_read("calibration/rig"), _RIG, said)


def _write_campaign_reference() -> str:
    from labrig.protocol.reference import write_reference

    said = "A campaign file says what is repeated, and over which values. " + _FOOT
    return write_reference(_read("protocols/campaign"), _CAMPAIGN, said)


def _write_commands_reference() -> str:
    from labrig.cli.command_reference import write_command_reference
    from labrig.cli.main import app

    return write_command_reference(app, _COMMANDS)


_PROTOCOL, _RIG, _CAMPAIGN, _COMMANDS = "Protocol files", "Rig files", "Campaign files", "Commands"
REFERENCE = (
    ManualPage("reference/commands", _COMMANDS, _write_commands_reference),
    ManualPage("reference/protocol", _PROTOCOL, _write_protocol_reference),
    ManualPage("reference/campaign", _CAMPAIGN, _write_campaign_reference),
    ManualPage("reference/rig", _RIG, _write_rig_reference),
)
