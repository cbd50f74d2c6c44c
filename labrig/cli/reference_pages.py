"""The pages of the manual that are generated when they are read: protocol, campaign and rig files, and the commands."""

from labrig.cli.schemas import make_schema
from labrig.report.manual import ManualPage

_FOOT = (
    "`labrig schema{}` prints the same as JSON Schema, which editors use to complete and check such files."
)


def _write_protocol_reference() -> str:
    from labrig.protocol.reference import write_reference

    said = "A protocol names its experiment; the other keys follow from that. " + _FOOT.format("")
    return write_reference(make_schema("protocol"), _PROTOCOL, said)


def _write_rig_reference() -> str:
    from labrig.protocol.reference import write_reference

    said = "A rig file says how the bench is built. " + _FOOT.format(" rig")
    return write_reference(make_schema("rig"), _RIG, said)


def _write_campaign_reference() -> str:
    from labrig.protocol.reference import write_reference

    said = "A campaign file says what is repeated, and over which values. " + _FOOT.format(" campaign")
    return write_reference(make_schema("campaign"), _CAMPAIGN, said)


def _write_commands_reference() -> str:
    from labrig.cli.command_reference import write_command_reference
    from labrig.cli.main import COMMANDS, make_app

    return write_command_reference(make_app(COMMANDS), _COMMANDS)


_PROTOCOL, _RIG, _CAMPAIGN, _COMMANDS = "Protocol files", "Rig files", "Campaign files", "Commands"
REFERENCE = (
    ManualPage("reference/commands", _COMMANDS, _write_commands_reference),
    ManualPage("reference/protocol", _PROTOCOL, _write_protocol_reference),
    ManualPage("reference/campaign", _CAMPAIGN, _write_campaign_reference),
    ManualPage("reference/rig", _RIG, _write_rig_reference),
)
